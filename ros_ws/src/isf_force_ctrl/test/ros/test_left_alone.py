"""Tools never stay on the sheet when nobody goes on with the part, or arms another one, and never move on stale news of
the machine."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from isf_core.errors import ErrorCode
from isf_msgs.action import LiftTool
from isf_msgs.msg import ForceCtrlState
from isf_ros import qos, stamps
from node_cell import Cell, Observed, call_action, small_ring, watched
from waiting import Waiting

pytestmark = pytest.mark.graph


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


class Left(Observed):
    """A cell whose tools rest on the sheet, after the first of two contours."""

    def __init__(self, waiting: Waiting, stack: ExitStack) -> None:
        super().__init__(waiting, stack)
        self._heights: tuple[list[float], list[float]] = ([], [])
        for tool, heights in enumerate(self._heights, start=1):
            heard = partial(self._on_pose, heights)
            self.node.create_subscription(PoseStamped, f"tool_{tool}/pose", heard, qos.SENSOR)
        self.start(contour_wait=600.0)  # they wait
        self.armed(count=2)
        assert self.form(small_ring(0, 2)).code == 0
        assert self.rests_in(ForceCtrlState.FREEZE)

    @staticmethod
    def _on_pose(heights: list[float], message: PoseStamped) -> None:
        heights.append(message.pose.position.z)

    def stand_at(self) -> tuple[float, float]:
        """m, heights of both tools. Of several poses that come from now on, a tenth of a second apart, force control
        has the first ones when the last ones are here."""
        for heights in self._heights:
            heights.clear()
        assert self.wait(lambda: all(len(heights) > 3 for heights in self._heights))
        return self._heights[0][-1], self._heights[1][-1]


@pytest.fixture
def left() -> Iterator[Left]:
    with watched(Left) as found:
        yield found


class Executive:
    """What an executive tells of itself, as often as it does."""

    def __init__(self, cell: Cell) -> None:
        self._publisher = cell.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.timer = cell.node.create_timer(0.5, self.notify)

    def notify(self) -> None:
        values = [KeyValue(key="pid", value="4711"), KeyValue(key="busy", value="True")]
        self._publisher.publish(DiagnosticArray(status=[DiagnosticStatus(name="/executive", values=values)]))


def test_the_tools_wait_as_long_as_the_executive_lives_and_leave_the_sheet_when_it_does_not(cell: Cell) -> None:
    heights: list[float] = []
    cell.node.create_subscription(PoseStamped, "tool_1/target", lambda m: heights.append(m.pose.position.z), qos.STREAM)
    cell.start(contour_wait=1.0)
    executive = Executive(cell)
    cell.armed(count=3)
    assert cell.form(small_ring(0, 3)).code == 0
    assert cell.wait(lambda: heights)  # the middleware may find who publishes them later than the results
    on_sheet = heights[-1]
    assert not cell.wait(lambda: len(cell.results) > 1, timeout=3.0)  # longer than contour_wait: a long correction
    assert cell.states[-1].mode == ForceCtrlState.FREEZE
    assert cell.form(small_ring(1, 3)).code == 0
    executive.timer.cancel()
    assert cell.wait(lambda: len(cell.results) > 2)
    result = cell.results[-1]
    assert (result.completed, result.code, result.index) == (False, ErrorCode.EXECUTIVE_LOST, 2)
    assert "4711" in result.message
    assert cell.rests_in(ForceCtrlState.IDLE)
    assert heights[-1] > on_sheet + 5e-3


def test_without_an_executive_the_next_contour_is_due(cell: Cell) -> None:
    cell.start(contour_wait=1.0)
    cell.armed(count=2)
    assert cell.form(small_ring(0, 2)).code == 0
    assert cell.wait(lambda: len(cell.results) > 1)
    assert (cell.results[-1].code, cell.results[-1].index) == (ErrorCode.CONTOUR_OVERDUE, 1)
    assert "contour_wait" in cell.results[-1].message
    assert cell.rests_in(ForceCtrlState.IDLE)
    cell.armed(count=1)  # and the cell can go on
    assert cell.form(small_ring()).code == 0


@pytest.mark.parametrize(
    ("ends", "code", "topic"),
    [("poses_until", ErrorCode.POSE_LOST, "tool_1/pose"), ("states_until", ErrorCode.NO_TARE, "machine/state")],
)
def test_what_a_driver_reported_that_reports_no_more_does_not_arm(
    cell: Cell, ends: str, code: ErrorCode, topic: str
) -> None:
    """Its tare ended with it, and its tools may stand anywhere."""
    cell.start({ends: 200})
    cell.armed()
    assert cell.form(small_ring()).code == 0
    assert cell.rests_in(ForceCtrlState.IDLE)
    response = cell.ask_to_arm()
    deadline = time.monotonic() + 30.0
    while response.code == 0 and time.monotonic() < deadline:  # still fresh
        assert cell.arm(plan_id="").code == 0
        assert cell.rests_in(ForceCtrlState.IDLE)
        response = cell.ask_to_arm()
    parked = stamps.to_nanoseconds(cell.states[-1].header.stamp)
    assert response.code == code
    assert topic in response.message
    assert "the driver has to publish" in response.message
    assert cell.newest_target <= parked + stamps.tick_nanoseconds(2, 500.0)  # by stamps: what was sent may come late


def test_tools_that_the_plan_before_left_on_the_sheet_are_lifted_by_the_next_one(left: Left) -> None:
    """Who arms anew and then disarms, without a contour, leaves no tool on the sheet."""
    assert max(map(abs, left.stand_at())) < 10e-3
    left.armed(plan_id="another")
    left.armed(plan_id="")
    assert left.rests_in(ForceCtrlState.IDLE)
    upper, lower = left.stand_at()
    assert upper > 24e-3
    assert lower < -24e-3


@pytest.mark.parametrize("tool", [1, 2])
def test_a_tool_that_is_elsewhere_by_now_rests_on_no_sheet(left: Left, tool: int) -> None:
    """Off the sheet already, the tools are not lifted along a wall where they no longer are."""
    before = left.stand_at()
    assert all(result.successful for result in left.set("machine", taken_off=tool))
    assert abs(left.stand_at()[tool - 1] - before[tool - 1]) > 2.9e-3
    left.armed(plan_id="another")
    goal = LiftTool.Goal(speed=5e-3, zero_force=5.0, max_lift=8e-3)
    refused, _ = call_action(left, LiftTool, "lift_tool", goal)
    assert refused.code == ErrorCode.NOT_ARMED
    assert "not on the sheet" in refused.message
