"""Measurements between contours: node force_ctrl and the simulated machine in processes of their own, in lockstep."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from isf_core.errors import ErrorCode
from isf_core.job import load_job
from isf_msgs.action import LiftTool, MoveAside
from isf_msgs.msg import ForceCtrlState
from isf_msgs.srv import Tare
from isf_planner import plan
from rclpy.action import ActionClient
from test_force_ctrl_node import LIMIT, Cell, started

pytestmark = pytest.mark.graph

JOB = Path(__file__).resolve().parents[4] / "examples" / "jobs" / "mini_cone.yaml"


class Measured:
    """The cell with a real machine node and the contours of the small example cone."""

    def __init__(self, cell: Cell, stack: ExitStack) -> None:
        self.cell, self.job_file = cell, load_job(JOB)
        self.plan = plan(self.job_file)
        stack.enter_context(started("-m", "isf_sim.node", autostart=True, job=JOB))
        stack.enter_context(started("-m", "isf_force_ctrl.node", autostart=True))
        assert cell._arm.wait_for_service(LIMIT)
        tare = cell.node.create_client(Tare, "machine/tare")
        assert tare.wait_for_service(LIMIT)
        future = tare.call_async(Tare.Request())
        assert cell.wait(future.done)
        assert future.result().code == 0
        cell.armed(plan_id=self.plan.plan_id, count=len(self.plan.contours), job=self.job_file.text)

    def form(self, count: int) -> None:
        for contour in self.plan.contours[:count]:
            assert self.cell.form(contour).completed

    def call(self, kind: Any, name: str, goal: Any) -> tuple[Any, list[Any]]:
        """Result and feedback of an action."""
        client = ActionClient(self.cell.node, kind, name)
        assert client.wait_for_server(LIMIT)
        seen: list[Any] = []
        sent = client.send_goal_async(goal, feedback_callback=lambda message: seen.append(message.feedback))
        assert self.cell.wait(sent.done)
        assert sent.result().accepted
        result = sent.result().get_result_async()
        assert self.cell.wait(result.done, 60.0)
        client.destroy()
        return result.result().result, seen


@pytest.fixture
def measured() -> Iterator[Measured]:
    rclpy.init()
    node = rclpy.create_node("observer")
    with ExitStack() as stack:
        yield Measured(Cell(node, stack), stack)
    node.destroy_node()
    rclpy.try_shutdown()


def test_lift_tool_measures_and_forming_goes_on(measured: Measured) -> None:
    goal = LiftTool.Goal(speed=5e-3, zero_force=5.0, max_lift=8e-3)
    refused, _ = measured.call(LiftTool, "lift_tool", goal)
    assert refused.code == ErrorCode.NOT_ARMED  # armed, but parked
    assert "not on the sheet" in refused.message

    measured.form(3)
    result, seen = measured.call(LiftTool, "lift_tool", goal)
    assert (result.code, result.message) == (0, "")
    assert 1e-3 < result.springback < 3e-3
    assert result.force > 20.0
    assert len(result.lift_z) == len(result.lift_force) > 100
    assert np.isfinite(result.lift_z).all()
    assert seen
    assert all(feedback.lift <= goal.max_lift for feedback in seen)

    moved, seen = measured.call(MoveAside, "move_aside", MoveAside.Goal())
    assert (moved.code, moved.message) == (0, "")
    assert seen
    assert measured.cell.form(measured.plan.contours[3]).completed
    short, _ = measured.call(LiftTool, "lift_tool", LiftTool.Goal(speed=5e-3, zero_force=5.0, max_lift=0.1e-3))
    assert short.code == ErrorCode.MEASUREMENT_FAILED
    assert np.isnan(short.springback)
    assert measured.cell.arm(plan_id="").code == 0
    assert measured.cell.rests_in(ForceCtrlState.IDLE)
