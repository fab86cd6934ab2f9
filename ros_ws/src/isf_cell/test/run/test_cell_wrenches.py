"""From the force on the tip to nine voltages and back to a wrench: the plant's model against that of node load_cell."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.rig import ToolAxis, load_rig
from isf_core.files.spindle_cells import CHANNELS, CellFault
from isf_load_cell.cell_file import spindle_cells_set_up
from isf_load_cell.stream import CellStream
from isf_sim.machine.spindle_cells import SpindleCellPlant

AXIS = load_rig("torrao2013").tool_1
WHOLE_CELLS = [("x1", "y1", "z1"), ("x2", "y2", "z2"), ("x3", "y3", "z3")]
FORCES = np.array([[90.0 * np.cos(a), 90.0 * np.sin(a), 340.0] for a in np.linspace(0.0, 6.28, 1000)])
"""N, once around the last contour of the 45 degree cone."""


def with_cells(**changes: object) -> ToolAxis:
    assert AXIS.spindle_cells is not None
    return AXIS.model_copy(update={"spindle_cells": AXIS.spindle_cells.model_copy(update=changes)})


def read(axis: ToolAxis, forces: np.ndarray, free: int = 250) -> tuple[np.ndarray, CellStream]:
    """Forces that are read of ``forces`` (n, 3) N after a tare of ``free`` readings."""
    assert axis.spindle_cells is not None
    plant, held = SpindleCellPlant(axis.spindle_cells, axis.weight, 1.0, 500.0, (0, 0, 2, 1)), np.full(9, np.nan)
    stream, found = CellStream(spindle_cells_set_up(axis).reading, free), []
    for tick in range(free):
        stream.add(tick + 1, plant.volts(np.zeros(3), tick, held))
    stream.tare()
    for tick, force in enumerate(forces, start=free):
        wrench = stream.add(tick + 1, plant.volts(force, tick, held))
        found.append(np.full(3, np.nan) if wrench is None else wrench[:3])
    return np.array(found), stream


def test_the_published_loads_come_back() -> None:
    exact = with_cells(noise=0.0, gain_error=0.0, adc_bits=32, rotation=(0.1, -0.2, 0.7))
    loads = np.array([[6500.0, 0.0, 13000.0], [0.0, 6500.0, 13000.0], [-3000.0, 2000.0, -500.0]])
    found, _ = read(exact, loads, free=20)  # without noise more would count as frozen
    assert found == pytest.approx(loads, abs=0.1)  # Torrao 2013, 3.4.2


@pytest.mark.parametrize("lost", [*[(name,) for name in CHANNELS], *WHOLE_CELLS], ids="+".join)
def test_any_one_channel_or_cell_lost_costs_less_than_one_percent(lost: tuple[str, ...]) -> None:
    faults = tuple(CellFault(channel=name, kind="open", after=0.6) for name in lost)  # type: ignore[arg-type]
    found, stream = read(with_cells(faults=faults), FORCES)
    error = found[50:] - FORCES[50:]
    means = error.reshape(-1, 50, 3).mean(axis=1)  # over 0.1 s
    assert np.linalg.norm(means, axis=1).max() < 0.01 * np.linalg.norm(FORCES[0])
    assert stream.fault is None
    warning = stream.warning()
    assert warning is not None
    assert all(name in warning.what for name in lost)


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (CellFault(channel="z3", kind="saturated", after=1.0), ErrorCode.WRENCH_OUT_OF_RANGE),
        (CellFault(channel="z3", kind="stuck", after=1.0), ErrorCode.WRENCH_FROZEN),
        (CellFault(channel="z3", kind="offset", value=0.1, after=1.0), ErrorCode.WRENCH_INCONSISTENT),
    ],
)
def test_a_fault_in_mid_part_is_named_with_its_code(fault: CellFault, code: ErrorCode) -> None:
    found, stream = read(with_cells(faults=(fault,)), FORCES)
    warning = stream.warning()
    assert warning is not None
    assert warning.code is code
    assert "channel z3 " in warning.what
    assert [error.code for error in stream.take_news()] == [code]
    later = (found - FORCES)[500:]
    assert np.abs(later.mean(axis=0)).max() < 3.5  # 1 % of 352 N


def test_a_swap_of_two_axial_cables_ends_the_stream() -> None:
    swapped = with_cells(faults=(CellFault(channel="z1", kind="swapped", other="z2"),))
    found, stream = read(swapped, FORCES)
    assert stream.fault is not None
    assert stream.fault.code is ErrorCode.WRENCH_INCONSISTENT
    assert "cables of load-cell channels z1 and z2 are exchanged" in stream.fault.what
    wrong = np.abs(found - FORCES)[np.isfinite(found).all(axis=1)]
    assert len(wrong) < 10  # readings before it shows


def test_sound_cells_say_nothing() -> None:
    found, stream = read(AXIS, FORCES)
    assert (stream.fault, stream.warning(), stream.take_news()) == (None, None, [])
    assert np.abs((found - FORCES).mean(axis=0)).max() < 0.5
