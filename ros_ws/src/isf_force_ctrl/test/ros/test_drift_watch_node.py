"""A load cell that has drifted, told and refused by node force_ctrl over real DDS."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from isf_core.errors import ErrorCode
from isf_force_ctrl.control_state import Flag
from isf_msgs.msg import ForceCtrlState
from node_cell import Cell, small_ring, watched

pytestmark = pytest.mark.graph


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


@pytest.fixture
def health(cell: Cell) -> list[DiagnosticStatus]:
    reported: list[DiagnosticStatus] = []

    def take(message: DiagnosticArray) -> None:
        reported.extend(status for status in message.status if status.name == "/force_ctrl")

    cell.node.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
    return reported


def shows(cell: Cell, health: list[DiagnosticStatus], level: bytes) -> bool:
    return cell.wait(lambda: health and health[-1].level == level and "1205 NO_TARE" in health[-1].message)


@pytest.mark.parametrize(
    "lockstep", [True, pytest.param(False, marks=[pytest.mark.slow, pytest.mark.clock])], ids=["lockstep", "real time"]
)
def test_a_drift_is_warned_of(cell: Cell, health: list[DiagnosticStatus], lockstep: bool) -> None:
    cell.start({"cell_drift": 15.0, "lockstep": lockstep}, lockstep=lockstep)
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (True, ErrorCode.NO_TARE)
    assert "tool_2 has drifted by 15." in result.message
    assert shows(cell, health, DiagnosticStatus.WARN)
    values = {item.key: float(item.value) for item in health[-1].values if item.key.startswith("drift_")}
    # the stand-in's cells have noise of 0.5 N and steps of 1 N; their mean over 50 readings
    assert values == pytest.approx({"drift_1": 0.0, "drift_2": 15.0}, abs=0.5)
    assert any(state.flags & Flag.DRIFT and state.mode == ForceCtrlState.CONTROL for state in cell.states)


def test_a_large_drift_is_refused(cell: Cell, health: list[DiagnosticStatus]) -> None:
    cell.start({"cell_drift": 45.0})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.NO_TARE)
    assert "tool_2 has drifted by 45." in result.message
    assert shows(cell, health, DiagnosticStatus.ERROR)
    modes = {state.mode for state in cell.states}
    assert not modes & {ForceCtrlState.ENGAGE, ForceCtrlState.CONTROL, ForceCtrlState.POSITION}


def test_the_limits_are_parameters(cell: Cell) -> None:
    cell.start({"cell_drift": 45.0}, drift_limit=50.0, drift_stop=60.0)
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code, result.message) == (True, 0, "")
