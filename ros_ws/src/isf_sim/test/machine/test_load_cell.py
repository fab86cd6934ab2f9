"""Load cell: noise, resolution, range, crosstalk and tare."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.rig import LoadCell, load_rig
from isf_sim.machine.load_cells import CellConstants, CellState, make_cell, read_again, read_cell, take_zero
from isf_sim.plant_constants import PlantConstants
from numpy.typing import NDArray

QUIET = PlantConstants(drift=0.0, zero_offset=0.0)


def cell(plant: PlantConstants = QUIET, gain: float = 1.0, **changes: object) -> tuple[CellConstants, CellState]:
    spec: LoadCell = load_rig("ren2018").load_cell.model_copy(update=changes)
    return make_cell(spec, plant, 500.0, gain, np.random.default_rng(1))


def readings(force: list[float], constants: CellConstants, state: CellState, count: int = 2000) -> NDArray[np.float64]:
    draws = np.random.default_rng(2).standard_normal((count, 6))
    more = np.random.default_rng(3).standard_normal((count, 3))
    out = np.empty((count, 6))
    for k in range(count):
        read_cell(np.array(force), draws[k], more[k], constants, state)
        out[k] = state.reading
    return out


def test_noise_is_one_percent_with_a_floor_and_steps_of_one_newton() -> None:
    """Ren 2018, 2.3.4 and 2.2; rounding to 1 N adds a variance of 1/12 N^2; 2000 draws: 5 % on a deviation."""
    values = readings([0.0, 400.0, 0.0], *cell(crosstalk=0.0))
    assert (values == np.round(values)).all()
    assert values[:, 1].std() == pytest.approx(np.sqrt(4.0**2 + 1 / 12), rel=0.05)
    assert values[:, 0].std() == pytest.approx(np.sqrt(0.5**2 + 1 / 12), rel=0.05)
    assert values[:, :3].mean(axis=0) == pytest.approx([0.0, 400.0, 0.0], abs=0.3)


def test_a_load_that_is_read_again_has_the_noise_of_the_cell() -> None:
    constants, _ = cell(crosstalk=0.0)
    before, draw = np.array([0.0, 400.0, -30.0, 0.0, 0.0, 0.0]), np.random.default_rng(4)
    values = np.array([read_again(before, constants, draw) for _ in range(2000)])
    assert (values[:, :3] == np.round(values[:, :3])).all()
    assert values[:, 1].std() == pytest.approx(np.sqrt(4.0**2 + 1 / 12), rel=0.05)
    assert values[:, :3].mean(axis=0) == pytest.approx(before[:3], abs=0.3)


def test_gain_and_crosstalk_are_within_their_bounds() -> None:
    constants, _ = cell(gain=1.03)
    assert np.diag(constants.matrix) == pytest.approx([1.03] * 6)
    off = constants.matrix[:3, :3][~np.eye(3, dtype=bool)]
    assert 0.0 < np.abs(off).max() <= 0.01 * 1.03


def test_saturates_at_the_range() -> None:
    constants, state = cell()
    values = readings([5000.0, -5000.0, 5000.0], constants, state, count=10)
    assert values[:, :3].max(axis=0) == pytest.approx([1500.0, -1500.0, 2000.0])
    assert state.clipped[0] == 10
    readings([50.0, 0.0, 0.0], constants, state, count=1)
    assert state.clipped[0] == 0


def test_drift_wanders_with_its_deviation_and_slowly() -> None:
    """Deviation 2 N over many correlation times (shortened to 0.1 s); in one tick it hardly moves."""
    plant = PlantConstants(zero_offset=0.0, drift_time=0.1)
    constants, state = cell(plant, noise_floor=0.0, noise_ratio=0.0, resolution=0.0)
    values = readings([0.0, 0.0, 0.0], constants, state, count=20000)[:, :3]
    # 400 correlation times in 3 axes: about 3 % on the deviation
    assert values.std() == pytest.approx(2.0, rel=0.12)
    assert np.diff(values, axis=0).std() == pytest.approx(2.0 * np.sqrt(2 * 0.002 / 0.1), rel=0.05)


def test_twelve_bits_over_the_range() -> None:
    """Ren 2018, 2.2: 12-bit converters; steps of 2 x 2000 N / 4096 = 0.977 N in z, which is the "about 1 N" told."""
    constants, state = cell(adc_bits=12, crosstalk=0.0)
    values = readings([0.0, 0.0, 321.0], constants, state, count=400)
    assert constants.resolution[2] == pytest.approx(0.977, abs=1e-3)
    assert np.allclose(values[:, 2] / constants.resolution[2], np.round(values[:, 2] / constants.resolution[2]))


def test_force_on_the_tip_gives_torques_by_its_distance() -> None:
    """A cell 0.28 m above the tip: M = r x F with r = (0, 0, -0.28)."""
    quiet = {"noise_ratio": 0.0, "noise_floor": 0.0, "resolution": 0.0, "crosstalk": 0.0}
    values = readings([100.0, 50.0, 700.0], *cell(tip_distance=0.28, **quiet), count=1)
    assert values[0] == pytest.approx([100.0, 50.0, 700.0, 14.0, -28.0, 0.0])


def test_matrix_of_the_rig_mixes_all_six_channels() -> None:
    matrix = np.eye(6)
    matrix[0, 4], matrix[3, 2] = 0.5, 0.001
    quiet = {"noise_ratio": 0.0, "noise_floor": 0.0, "resolution": 0.0, "tip_distance": 0.1}
    values = readings([0.0, 0.0, 1000.0], *cell(matrix=tuple(map(tuple, matrix)), **quiet), count=1)
    assert values[0] == pytest.approx([0.0, 0.0, 1000.0, 1.0, 0.0, 0.0])
    values = readings([100.0, 0.0, 0.0], *cell(matrix=tuple(map(tuple, matrix)), **quiet), count=1)
    assert values[0, 0] == pytest.approx(100.0 - 0.5 * 10.0)


def test_tool_weight_is_taken_by_tare_and_takes_range() -> None:
    spec = load_rig("ren2018").load_cell
    constants, state = make_cell(spec, QUIET, 500.0, 1.0, np.random.default_rng(1), weight=300.0)
    zero = take_zero(constants, state, 200, np.random.default_rng(4))
    assert zero[2] == pytest.approx(-300.0, abs=0.5)
    values = readings([0.0, 0.0, -1800.0], constants, state, count=10)
    assert values[:, 2].min() == pytest.approx(-2000.0 + 300.0, abs=0.5)
