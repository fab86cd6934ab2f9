"""Wrenches that stop coming by the clock: the tools stand and go on, and what has to leave the sheet leaves it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from isf_core.errors import ErrorCode
from isf_msgs.action import LiftTool
from isf_msgs.msg import ForceCtrlState
from isf_ros import conversion, qos
from node_cell import Observed, call_action, long_ring, small_ring, watched

pytestmark = [pytest.mark.graph, pytest.mark.clock]

BOTH, UPPER, NONE = 3, 1, 0
"""Whose wrenches the stand-in keeps to itself."""


class Cell(Observed):
    """The observed cell by the clock, with the targets of the upper tool."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.tips: list[tuple[float, float, float]] = []
        self.node.create_subscription(
            PoseStamped, "tool_1/target", lambda m: self.tips.append(conversion.tip_of(m)), qos.STREAM
        )

    def begin(self, machine: dict[str, object] | None = None, **parameters: object) -> None:
        """Start the nodes, and a contour; it is in full control when this returns."""
        self.start({"lockstep": False, **(machine or {})}, lockstep=False, **parameters)
        self.setter("machine")  # to find it may take as long as the contour
        self.armed()
        self._contours.publish(conversion.contour_to_message(long_ring()))
        assert self.wait(lambda: self.states and self.states[-1].mode == ForceCtrlState.CONTROL)

    def silence(self, tools: int) -> None:
        """Until it is over: no wrenches of ``tools``; returns when the controller has brought the tools to a stand."""
        seen = len(self.states)
        assert self.set("machine", silent=tools)[0].successful
        assert self.wait(lambda: any(state.flags & ForceCtrlState.PAUSED for state in self.states[seen:]))


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


def test_the_tools_stand_and_go_on_when_the_wrenches_are_back(cell: Cell) -> None:
    cell.begin()
    cell.silence(BOTH)
    seen = len(cell.tips)
    assert cell.wait(lambda: len(cell.tips) > seen + 250)  # half a second of targets: to brake, and to stand
    standing = np.array(cell.tips[seen + 200 :])
    assert np.abs(standing - standing[0]).max() < 1e-9
    assert cell.set("machine", silent=NONE)[0].successful
    assert cell.wait(lambda: cell.results)
    result = conversion.result_from_message(cell.results[0])
    assert (result.completed, result.code) == (True, 0)
    # no force was controlled meanwhile, and it was before and after
    stretches = [(engaged, len(list(ticks))) for engaged, ticks in groupby(result.tick_engaged.tolist())]
    inner = stretches[1:-1] if not stretches[0][0] else stretches[:-1]
    assert max(length for engaged, length in inner if not engaged) > 200
    assert cell.wait(lambda: int(cell.health.get("pauses", 0)) >= 1)


def test_after_a_fault_the_tools_leave_the_sheet_without_wrenches(cell: Cell) -> None:
    cell.begin(wrench_timeout=1.0)
    cell.silence(BOTH)
    assert cell.wait(lambda: cell.results)
    assert (cell.results[0].completed, cell.results[0].code) == (False, ErrorCode.WRENCH_LOST)
    assert cell.rests_in(ForceCtrlState.HOLD)
    on_sheet = cell.tips[-1][2]
    assert cell.ask_to_arm(plan_id="").code == 0
    assert cell.rests_in(ForceCtrlState.IDLE)
    assert cell.tips[-1][2] > on_sheet + 50e-3


def test_tools_at_rest_leave_the_sheet_without_wrenches(cell: Cell) -> None:
    cell.start({"lockstep": False}, lockstep=False)
    cell.setter("machine")
    cell.armed(count=2)
    assert cell.form(small_ring(0, 2)).code == 0
    on_sheet = cell.tips[-1][2]
    cell.silence(BOTH)
    assert cell.ask_to_arm(plan_id="").code == 0
    assert cell.rests_in(ForceCtrlState.IDLE)
    assert cell.tips[-1][2] > on_sheet + 50e-3


def test_an_overload_of_one_tool_is_seen_while_the_other_one_is_silent(cell: Cell) -> None:
    cell.begin(wrench_timeout=20.0)
    cell.silence(UPPER)
    assert cell.set("machine", saturated_at=0)[0].successful
    assert cell.wait(lambda: cell.results)
    assert (cell.results[0].completed, cell.results[0].code) == (False, ErrorCode.WRENCH_OUT_OF_RANGE)
    assert "tool_2" in cell.results[0].message


def test_a_measurement_does_not_wait_for_late_wrenches(cell: Cell) -> None:
    cell.start({"lockstep": False}, lockstep=False)
    cell.setter("machine")
    cell.armed(count=2)
    assert cell.form(small_ring(0, 2)).code == 0
    seen = len(cell.states)
    assert cell.set("machine", late_at=0)[0].successful
    assert cell.wait(lambda: any(state.flags & ForceCtrlState.PAUSED for state in cell.states[seen:]))
    goal = LiftTool.Goal(speed=1e-3, zero_force=5.0, max_lift=5e-3)
    result, _ = call_action(cell, LiftTool, "lift_tool", goal)
    assert result.code == ErrorCode.WRENCH_LATE
    assert "too late for 0.25 s" in result.message


def test_velocities_end_without_poses_however_long_wrenches_are_waited_for(cell: Cell) -> None:
    cell.begin({"twist": True}, output="twist", wrench_timeout=60.0)
    assert cell.set("machine", poses_until=0)[0].successful
    assert cell.wait(lambda: cell.results)
    assert (cell.results[0].completed, cell.results[0].code) == (False, ErrorCode.POSE_LOST)
    assert "for 0.25 s" in cell.results[0].message


def test_wrenches_now_and_then_do_not_keep_a_contour_going(cell: Cell) -> None:
    """Two or three a second: none is missing for three seconds, and the tools stand nearly all the time."""
    cell.begin()
    assert cell.set("machine", lost_share=0.995)[0].successful
    assert cell.wait(lambda: cell.results)
    assert (cell.results[0].completed, cell.results[0].code) == (False, ErrorCode.WRENCH_LOST)
    assert "again and again" in cell.results[0].message


def test_a_tare_that_is_lost_ends_the_contour_and_lets_none_begin(cell: Cell) -> None:
    cell.begin()
    assert cell.set("machine", tared=False)[0].successful
    assert cell.wait(lambda: cell.results)
    assert (cell.results[0].completed, cell.results[0].code) == (False, ErrorCode.NO_TARE)
    assert "no longer tared" in cell.results[0].message
    assert cell.ask_to_arm(plan_id="").code == 0
    assert cell.rests_in(ForceCtrlState.IDLE)  # lifted all the same
    assert cell.ask_to_arm().code == ErrorCode.NO_TARE
