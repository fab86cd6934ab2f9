"""Measurements between contours: node force_ctrl and the simulated machine in processes of their own, in lockstep."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import forked_process
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile, load_job
from isf_force_ctrl import ControlConfig
from isf_msgs.action import LiftTool, MoveAside
from isf_msgs.msg import ForceCtrlState
from isf_msgs.srv import Stop, Tare
from isf_planner import plan
from isf_ros import qos
from node_cell import LIMIT, QUICK, RIG, Cell, call_action, small_ring, watched

pytestmark = pytest.mark.graph

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"


def quick_job(folder: Path) -> Path:
    """The job of the small example cone in fewer ticks, as a file in ``folder``."""
    text = JOB.read_text(encoding="utf-8")
    parts = str(JOB.parents[1] / "parts")
    changes = {"rig: ren2018": f"rig: {RIG}", "rate: 500 Hz": "rate: 250 Hz", "../parts": parts}
    changes["incremental_depth: 0.5 mm"] = "incremental_depth: 1 mm"
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path = folder / "quick_job.yaml"
    path.write_text(text, encoding="utf-8")
    return path


class Measured:
    """The cell with a real machine node and the contours of the small example cone; ``folder`` for its job file."""

    def __init__(self, cell: Cell, folder: Path, *, lockstep: bool = True) -> None:
        job = quick_job(folder)
        self.cell, self.job_file = cell, load_job(job)
        self.plan = plan(self.job_file)
        mode = {"lockstep": lockstep}
        cell.stack.enter_context(forked_process.node("-m", "isf_sim.node", autostart=True, job=job, **mode))
        cell.stack.enter_context(forked_process.node("-m", "isf_force_ctrl.node", autostart=True, **QUICK, **mode))
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


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


@pytest.fixture
def measured(cell: Cell, tmp_path: Path) -> Measured:
    return Measured(cell, tmp_path)


def test_lift_tool_measures_and_forming_goes_on(measured: Measured) -> None:
    goal = LiftTool.Goal(speed=5e-3, zero_force=5.0, max_lift=8e-3)
    refused, _ = call_action(measured.cell, LiftTool, "lift_tool", goal)
    assert refused.code == ErrorCode.NOT_ARMED  # armed, but parked
    assert "not on the sheet" in refused.message

    measured.form(2)
    result, seen = call_action(measured.cell, LiftTool, "lift_tool", goal)
    assert (result.code, result.message) == (0, "")
    assert 1e-3 < result.springback < 3e-3
    assert result.force > 20.0
    assert len(result.lift_z) == len(result.lift_force) > 100
    assert np.isfinite(result.lift_z).all()
    assert seen
    assert all(feedback.lift <= goal.max_lift for feedback in seen)

    moved, seen = call_action(measured.cell, MoveAside, "move_aside", MoveAside.Goal())
    assert (moved.code, moved.message) == (0, "")
    assert seen
    assert measured.cell.form(measured.plan.contours[2]).completed
    short, _ = call_action(
        measured.cell, LiftTool, "lift_tool", LiftTool.Goal(speed=5e-3, zero_force=5.0, max_lift=0.1e-3)
    )
    assert short.code == ErrorCode.MEASUREMENT_FAILED
    assert np.isnan(short.springback)
    assert measured.cell.arm(plan_id="").code == 0
    assert measured.cell.rests_in(ForceCtrlState.IDLE)


def test_a_move_ends_with_the_fault_of_a_machine_that_stands_still(measured: Measured) -> None:
    """Nobody but force_ctrl is there to see that no tick comes any more."""
    measured.form(1)
    stop = measured.cell.node.create_client(Stop, "machine/stop")
    assert stop.wait_for_service(LIMIT)
    stopped = stop.call_async(Stop.Request(reason="a test"))
    assert measured.cell.wait(stopped.done)
    moved, _ = call_action(measured.cell, MoveAside, "move_aside", MoveAside.Goal())
    assert moved.code == ErrorCode.STOP_REQUESTED
    assert "protective stop: a test" in moved.message


@pytest.mark.clock
def test_a_contour_by_the_clock_ends_with_the_fault_of_a_machine_that_stands_still(cell: Cell, tmp_path: Path) -> None:
    """Its ticks go on, and would come to the end of a contour that nobody forms."""
    measured = Measured(cell, tmp_path, lockstep=False)
    stop = cell.node.create_client(Stop, "machine/stop")
    assert stop.wait_for_service(LIMIT)
    cell.publish(measured.plan.contours[0])
    assert cell.rests_in(ForceCtrlState.POSITION)
    stopped = stop.call_async(Stop.Request(reason="a test"))
    assert cell.wait(stopped.done)
    assert cell.wait(lambda: cell.results)
    (result,) = cell.results
    assert result.code == ErrorCode.STOP_REQUESTED
    assert "protective stop: a test" in result.message


@pytest.mark.clock
def test_move_aside_by_the_clock(cell: Cell) -> None:
    """In real time, against a driver that never waits; how long it takes is the computer's business."""
    tips: list[tuple[float, float, float]] = []

    def keep(pose: PoseStamped) -> None:
        tips.append((pose.pose.position.x, pose.pose.position.y, pose.pose.position.z))

    cell.node.create_subscription(PoseStamped, "tool_1/target", keep, qos.STREAM)
    cell.start({"lockstep": False}, lockstep=False)
    cell.armed(count=2)
    assert cell.form(small_ring(0, 2)).completed
    moved, seen = call_action(cell, MoveAside, "move_aside", MoveAside.Goal())
    assert (moved.code, moved.message) == (0, "")
    assert seen
    config = ControlConfig.from_job(JobFile(cell.job, JOB.parent))
    there = (*config.aside, config.park_height)
    assert cell.wait(lambda: tips[-1] == pytest.approx(there, abs=1e-4))
    assert cell.form(small_ring(1, 2)).completed
