"""Action ``identify`` on the real node over DDS, with the simulated machine and with a machine that fails."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_sandbox import ring
from isf_core.errors import ErrorCode
from isf_core.files.rig import load_rig
from isf_msgs.action import Identify
from isf_msgs.msg import ForceCtrlState
from isf_ros import conversion
from node_cell import FAR_JOB, Cell, call_action, watched
from test_measurement_node import Measured

pytestmark = pytest.mark.graph


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


def goal(kind: int, **fields: Any) -> Identify.Goal:
    return Identify.Goal(**{"property": kind, "tool": 1, "repeats": 1, "max_force": 200.0, **fields})


def call(cell: Cell, request: Identify.Goal, *, cancel_in: str = "") -> tuple[Any, list[Any]]:
    """Result and feedback; ``cancel_in``: cancelled in the first phase that has this in its name."""
    cancel_when = (lambda feedback: cancel_in in feedback.phase) if cancel_in else None
    return call_action(cell, Identify, "identify", request, cancel_when=cancel_when, timeout=400.0)


def test_identified_over_dds(cell: Cell, tmp_path: Path) -> None:
    Measured(cell, tmp_path)
    for refused in ({"max_force": float("nan")}, {"places": [0.2, 0.0, 0.0]}, {"max_force": -1.0}):
        result, _ = call(cell, goal(Identify.Goal.TOOL_COMPLIANCE, **refused))
        assert result.code == ErrorCode.MEASUREMENT_REFUSED
    cancelled, _ = call(cell, goal(Identify.Goal.TOOL_COMPLIANCE), cancel_in="searching")
    assert cancelled.code == ErrorCode.STOPPED
    assert list(cancelled.value) == []

    result, seen = call(cell, goal(Identify.Goal.TOOL_COMPLIANCE, places=[0.0, 0.0, 0.0]))
    assert (result.code, result.message) == (0, "")
    assert np.isnan(result.value[:2]).all()
    # the plant's 0.1 um/N
    assert result.value[2] == pytest.approx(0.1e-6, rel=0.1)
    assert 0.0 < result.uncertainty[2] < 0.02e-6
    assert {item.progress for item in seen} <= {0.0, 1.0}
    assert any("carrying" in item.phase for item in seen)
    piece = tmp_path / "found.yaml"
    piece.write_text(result.file_text)
    assert load_rig(str(piece)).tool_1.compliance[2] == pytest.approx(result.value[2], abs=1e-10)

    servo, _ = call(cell, goal(Identify.Goal.SERVO_RESPONSE))
    assert servo.code == 0
    assert servo.value[0] == pytest.approx(30.0, rel=0.03)


def test_refused_before_arming_and_while_forming(cell: Cell) -> None:
    cell.start()
    result, _ = call(cell, goal(Identify.Goal.SERVO_RESPONSE))
    assert result.code == ErrorCode.NOT_ARMED
    cell.armed()
    # long enough that the tools move still when the node has the next goal
    cell._contours.publish(conversion.contour_to_message(ring(0, 1, radius=40e-3, points=240)))
    assert cell.wait(lambda: any(state.mode == ForceCtrlState.APPROACH for state in cell.states))
    result, _ = call(cell, goal(Identify.Goal.SERVO_RESPONSE))
    assert result.code == ErrorCode.NOT_ARMED
    assert "moving" in result.message


def test_wrenches_that_come_tared_are_enough(cell: Cell) -> None:
    """What may be armed may be measured: a driver of level 1 tells nobody that its load cells are tared."""
    cell.start({"tared": False}, wrenches_tared=True)
    cell.armed()
    cancelled(cell)


def test_the_servo_of_a_job_with_one_tool(cell: Cell) -> None:
    """Nobody tells the forces on tool 2, as with a driver of one tool; in lockstep wrenches come in pairs."""
    cell.start({"silent": 2, "lockstep": False}, lockstep=False)
    one_tool = (
        FAR_JOB.replace("DSIF", "SPIF").replace("tool_2: {radius: 5 mm}\n", "").replace("support_force: 120 N, ", "")
    )
    cell.armed(job=one_tool)
    cancelled(cell)


def cancelled(cell: Cell) -> None:
    """Begin with the servo, and cancel it while the tool moves; fails soon where it does not begin."""
    request = goal(Identify.Goal.SERVO_RESPONSE)
    result, _ = call_action(cell, Identify, "identify", request, cancel_when=lambda told: "chirp" in told.phase)
    assert result.code == ErrorCode.STOPPED, result.message


@pytest.mark.parametrize(
    ("fault", "code"), [("nan_at", ErrorCode.WRENCH_NOT_FINITE), ("silent_at", ErrorCode.WRENCH_LOST)]
)
def test_a_cell_that_fails_ends_it(cell: Cell, fault: str, code: ErrorCode) -> None:
    cell.start({fault: 400}, wrench_timeout=2.0)
    cell.armed()
    result, _ = call(cell, goal(Identify.Goal.LOAD_CELL_SIGNS, places=[0.01, 0.0, 0.0]))
    assert result.code == code
    assert cell.rests_in(ForceCtrlState.HOLD)
