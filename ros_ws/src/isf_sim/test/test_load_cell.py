"""Load cell: noise, resolution, range, crosstalk and tare."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.rig import LoadCell, load_rig
from isf_sim.load_cell import CellConstants, CellState, make_cell, read_cell
from isf_sim.plant_constants import PlantConstants
from numpy.typing import NDArray

QUIET = PlantConstants(drift=0.0, zero_offset=0.0)


def cell(plant: PlantConstants = QUIET, gain: float = 1.0, **changes: float) -> tuple[CellConstants, CellState]:
    spec: LoadCell = load_rig("ren2018").load_cell.model_copy(update=changes)
    return make_cell(spec, plant, 500.0, gain, np.random.default_rng(1))


def readings(force: list[float], constants: CellConstants, state: CellState, count: int = 2000) -> NDArray[np.float64]:
    draws = np.random.default_rng(2).standard_normal((count, 6))
    out = np.empty((count, 3))
    for k in range(count):
        read_cell(np.array(force), draws[k], constants, state)
        out[k] = state.reading
    return out


def test_noise_is_one_percent_with_a_floor_and_steps_of_one_newton() -> None:
    """Ren 2018, 2.3.4 and 2.2; rounding to 1 N adds a variance of 1/12 N^2; 2000 draws: 5 % on a deviation."""
    values = readings([0.0, 400.0, 0.0], *cell(crosstalk=0.0))
    assert (values == np.round(values)).all()
    assert values[:, 1].std() == pytest.approx(np.sqrt(4.0**2 + 1 / 12), rel=0.05)
    assert values[:, 0].std() == pytest.approx(np.sqrt(0.5**2 + 1 / 12), rel=0.05)
    assert values.mean(axis=0) == pytest.approx([0.0, 400.0, 0.0], abs=0.3)


def test_gain_and_crosstalk_are_within_their_bounds() -> None:
    constants, _ = cell(gain=1.03)
    assert np.diag(constants.matrix) == pytest.approx([1.03] * 3)
    off = constants.matrix[~np.eye(3, dtype=bool)]
    assert 0.0 < np.abs(off).max() <= 0.01 * 1.03


def test_saturates_at_the_range() -> None:
    values = readings([5000.0, -5000.0, 5000.0], *cell(), count=10)
    assert values.max(axis=0) == pytest.approx([1500.0, -1500.0, 2000.0])


def test_drift_wanders_with_its_deviation_and_slowly() -> None:
    """Deviation 2 N over many correlation times (shortened to 0.1 s); in one tick it hardly moves."""
    plant = PlantConstants(zero_offset=0.0, drift_time=0.1)
    constants, state = cell(plant, noise_floor=0.0, noise_ratio=0.0, resolution=0.0)
    values = readings([0.0, 0.0, 0.0], constants, state, count=20000)
    # 400 correlation times in 3 axes: about 3 % on the deviation
    assert values.std() == pytest.approx(2.0, rel=0.12)
    assert np.diff(values, axis=0).std() == pytest.approx(2.0 * np.sqrt(2 * 0.002 / 0.1), rel=0.05)
