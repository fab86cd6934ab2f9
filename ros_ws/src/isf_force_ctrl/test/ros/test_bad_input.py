"""Bad input to node force_ctrl in its own process, over real DDS: each ends with a code, a hold or a refusal.

What a wrench can have wrong in itself stands in test_force_ctrl_node.py; here are time, places and parameters.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
from contact_sandbox import spiral
from isf_core.contour import Contour
from isf_core.errors import ErrorCode
from isf_force_ctrl.node import ForceCtrlNode
from isf_force_ctrl.ros.parameters import ForceCtrlParameters
from isf_msgs.msg import ForceCtrlState
from isf_ros import conversion, stamps
from node_cell import LIMIT, Observed, long_ring, small_ring, watched
from rclpy.lifecycle import TransitionCallbackReturn

pytestmark = pytest.mark.graph


class Faulty(Observed):
    """The observed cell, and the faults of a stand-in that goes on afterwards."""

    def lifted(self) -> None:
        """Out of HOLD: tools parked, and the machine has done its last targets, with which it would take a change."""
        assert self.arm(plan_id="").code == 0
        assert self.rests_in(ForceCtrlState.IDLE)
        assert self.wait(lambda: self.newest_wrench > stamps.to_nanoseconds(self.states[-1].header.stamp))

    def ends_with(self, code: ErrorCode, **fault: object) -> str:
        """Form a contour, let the stand-in do ``fault`` on the way; text of the result, which must have ``code``."""
        self.setter("machine")  # to find it may take as long as the contour
        self.armed()
        seen, states = len(self.results), len(self.states)
        self._contours.publish(conversion.contour_to_message(long_ring()))
        forming = (ForceCtrlState.ENGAGE, ForceCtrlState.CONTROL)
        assert self.wait(lambda: any(state.mode in forming for state in self.states[states:]))
        assert all(result.successful for result in self.set("machine", **fault))
        assert self.wait(lambda: len(self.results) > seen)
        result = self.results[-1]
        assert (result.completed, result.code) == (False, code)
        assert self.rests_in(ForceCtrlState.HOLD)
        return str(result.message)


@pytest.fixture
def cell() -> Iterator[Faulty]:
    with watched(Faulty) as found:
        yield found


def jumped(text: str) -> float:
    """s by which a clock jumped, as the node tells it."""
    reported = re.search(r"jumped by ([+-][\d.]+) s", text)
    assert reported is not None, text
    return float(reported.group(1))


def moved(contour: Contour, by: tuple[float, float, float]) -> Contour:
    return replace(
        contour,
        contact=contour.contact + by,
        forming_tip=contour.forming_tip + by,
        support_tip=contour.support_tip + by,
    )


@pytest.mark.clock
def test_late_messages_and_clocks_that_jump_in_real_time(cell: Faulty) -> None:
    cell.start({"lockstep": False, "scattered_share": 0.1}, lockstep=False, wrench_timeout=0.5)
    # Some messages overtaken by newer ones: counted, not used, and forming goes on.
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    assert (result.completed, result.code) == (True, 0)
    assert result.lost_messages > 0
    assert cell.wait(lambda: int(cell.health.get("old_wrenches", 0)) > 20)

    # All of them 50 ms late: the loop's delay would be too long, hold.
    text = cell.ends_with(ErrorCode.WRENCH_LATE, late_at=0)
    assert "later than the first ones" in text
    cell.set("machine", late_at=-1, scattered_share=0.0)
    cell.lifted()

    for jump in (5.0, -5.0):
        text = cell.ends_with(ErrorCode.WRENCH_CLOCK, jump_at=0, jump=jump)
        assert jumped(text) == pytest.approx(jump, abs=1.0)  # and what the message waited on a busy computer
        cell.lifted()  # the new time is taken as it is
        cell.set("machine", jump_at=-1)


def test_clocks_that_jump_in_lockstep(cell: Faulty) -> None:
    cell.start()
    assert jumped(cell.ends_with(ErrorCode.WRENCH_CLOCK, jump_at=0, jump=5.0)) == pytest.approx(5.0, abs=1.0)
    before = cell.targets
    assert cell.wait(lambda: cell.targets > before + 2)  # held: the last targets are repeated
    cell.lifted()  # in the new time

    cell.set("machine", jump_at=-1)  # back, with the first tick of the next contour
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_CLOCK)
    assert jumped(result.message) == pytest.approx(-5.0, abs=1.0)
    cell.lifted()


def test_wrenches_published_best_effort_are_taken_and_reported(cell: Faulty) -> None:
    cell.start({"best_effort": True})
    cell.armed()
    assert cell.form(small_ring()).code == 0
    assert cell.wait(lambda: "qos_incompatible" in cell.health)
    assert cell.health["qos_incompatible"] == "machine/state, tool_1/wrench, tool_2/wrench"


def test_places_that_cannot_be(cell: Faulty) -> None:
    cell.start()
    cell.armed(count=3)
    outside = cell.form(moved(small_ring(0, 3), (0.2, 0.0, 0.0)))
    assert (outside.completed, outside.code) == (False, ErrorCode.CONTOUR_REJECTED)
    assert "outside the travel" in outside.message
    assert cell.targets == 0

    turns = spiral(3, radius=10e-3, points=60)
    first = cell.form(turns[0])
    assert (first.completed, first.code) == (True, 0)
    apart = cell.form(moved(turns[1], (0.0, 8e-3, 0.0)))
    assert (apart.completed, apart.code) == (False, ErrorCode.CONTOUR_NOT_JOINED)
    joined = cell.form(turns[1])  # the tools wait where they were; the right contour goes on
    assert (joined.completed, joined.code) == (True, 0)


def test_an_offset_stays_within_its_limit(cell: Faulty) -> None:
    # No offset that is allowed reaches the sheet; at a constant feed, else the tools would wait for contact in places.
    cell.start({"gap": 5e-3}, feed_floor=1.0)
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    assert result.completed
    assert result.saturations > 0
    limit = 1.5e-3
    assert np.nanmax(np.abs(result.force_offset)) <= limit + 1e-9
    planned = small_ring().support_tip
    assert np.nanmax(np.linalg.norm(result.support_target - planned, axis=1)) <= limit + 0.2e-3


def numeric() -> list[str]:
    return [item.name for item in fields(ForceCtrlParameters) if type(item.default) in (int, float)]


@pytest.mark.parametrize("name", numeric())
def test_a_parameter_out_of_range_is_refused_at_the_start(name: str) -> None:
    item = next(item for item in fields(ForceCtrlParameters) if item.name == name)
    metadata = item.metadata
    assert math.isfinite(metadata["minimum"])
    wrong: list[Any] = [metadata["minimum"] - 1]
    if math.isfinite(metadata["maximum"]):
        wrong.append(metadata["maximum"] * 2 + 1)
    if isinstance(item.default, float):
        wrong.append(".nan")
    for value in wrong:
        rclpy.init(args=["--ros-args", "-p", f"{name}:={value}"])
        try:
            node = ForceCtrlNode()
            assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
            assert f"{int(ErrorCode.FILE_FIELD)} FILE_FIELD" in node._text
            assert name in node._text
            node.destroy_node()
        finally:
            rclpy.try_shutdown()


def test_parameters_out_of_range_in_a_running_node(cell: Faulty) -> None:
    with forked_process.node("-m", "isf_force_ctrl.node", autostart=True, loop_gain=-1.0):
        assert cell.wait(lambda: "loop_gain" in cell.message)
        assert cell.health["state"] == "unconfigured"
        assert "FILE_FIELD" in cell.message
        # nor is it taken at run time
        values = {name: type(getattr(ForceCtrlParameters(), name))(-5) for name in numeric()}
        results = cell.set("force_ctrl", **values)
        assert len(results) == len(values)
        assert not any(result.successful for result in results)
        words = ("read-only", "out of range", "not within")
        assert all(any(word in result.reason for word in words) for result in results)


def test_a_parameter_of_another_type_ends_the_process_with_a_text(capfd: pytest.CaptureFixture[str]) -> None:
    with forked_process.node("-m", "isf_force_ctrl.node", loop_gain="fast") as process:
        assert process.wait(LIMIT) == 2
    error = capfd.readouterr().err
    assert "FILE_FIELD" in error
    assert "loop_gain" in error
    assert "Traceback" not in error


def test_a_plan_that_is_left_keeps_the_wrench_of_a_tick_that_is_there(cell: Faulty) -> None:
    """The machine would tell it again only after a while, and the tools would go on for that long."""
    cell.start()
    cell.setter("machine")  # to find it may take as long as the contour
    cell.armed()
    cell._contours.publish(conversion.contour_to_message(long_ring()))
    assert cell.wait(lambda: any(state.mode == ForceCtrlState.CONTROL for state in cell.states))
    assert all(result.successful for result in cell.set("machine", silent=1))
    told = 0
    while told < cell.newest_wrench:  # of tool_1; of the tick after it tool_2 alone is told
        told = cell.newest_wrench
        cell.wait(lambda told=told: cell.newest_wrench > told, timeout=0.3)
    assert cell.arm(plan_id="").code == 0
    assert all(result.successful for result in cell.set("machine", silent=2))
    assert cell.wait(
        lambda: cell.newest_wrench > told + 3 * stamps.NANO // 1000
    )  # a tick is 2 ms, this is the next but one
    assert all(result.successful for result in cell.set("machine", silent=0))
    assert cell.rests_in(ForceCtrlState.IDLE)
