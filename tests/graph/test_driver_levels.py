"""A driver of each level, in a process of its own, under the executive: what it does not offer is done without."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from isf_cell.processes.process_group import ProcessGroup
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_core.files.yaml_file import find_named
from isf_msgs.action import FormPart
from isf_msgs.msg import ContourResult, ForceCtrlState, JobInfo
from isf_ros import qos
from isf_ros.conversion import result_from_message
from quick_cone import quick_cone
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from waiting import Waiting

pytestmark = [pytest.mark.graph, pytest.mark.clock, pytest.mark.usefixtures("forked_nodes")]

RATE = 100.0
QUICK = {"acceleration": 2.0, "seam_speed": 1.0}
SQUEEZED = 60.0
"""N, support force of the job."""


def tiny_part(folder: Path, springback: str = "method: none") -> JobFile:
    """The small cone in two quick contours, with the tools parked near the sheet."""
    rig = find_named("rigs", "ren2018").read_text(encoding="utf-8")
    (folder / "near.yaml").write_text(rig.replace("park_height: 100 mm", "park_height: 25 mm"), encoding="utf-8")
    text = quick_cone(springback, step="2.5 mm").text
    for old, new in {
        "feed: 20 mm/s": "feed: 80 mm/s",
        "ren2018": str(folder / "near.yaml"),
        "support_force: 120 N": f"support_force: {SQUEEZED:g} N",
    }.items():
        assert old in text
        text = text.replace(old, new)
    return JobFile(text, quick_cone().base)


class Cell:
    """The nodes above a driver, and one that asks them for parts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.node = rclpy.create_node("observer")
        self._waiting = Waiting(self.node)
        self.wait = self._waiting.until
        self.results: list[Any] = []
        self.infos: list[JobInfo] = []
        self.scans: list[PointCloud2] = []
        self.states: list[ForceCtrlState] = []
        """Of force control in the part that was formed last."""
        self.node.create_subscription(
            ContourResult, "contour/result", lambda m: self.results.append(result_from_message(m)), qos.EVENT
        )
        self.node.create_subscription(JobInfo, "part/info", self.infos.append, qos.LATCHED)
        self.node.create_subscription(ForceCtrlState, "force_ctrl/state", self.states.append, qos.STREAM_SOURCE)
        self.node.create_subscription(PointCloud2, "scan", self.scans.append, qos.LATCHED)
        self._action = ActionClient(self.node, FormPart, "form_part")
        self._set = self.node.create_client(SetParameters, "force_ctrl/set_parameters")

    def close(self) -> None:
        self._action.destroy()
        self._waiting.close()
        self.node.destroy_node()

    @contextmanager
    def wrenches_tared(self) -> Iterator[None]:
        """Force control is told that the wrenches come tared, until the end."""
        for value in (True, False):
            request = SetParameters.Request(parameters=[Parameter("wrenches_tared", value=value).to_parameter_msg()])
            sent = self._set.call_async(request)
            assert self.wait(sent.done)
            assert sent.result().results[0].successful
            if value:
                yield

    def form(self, springback: str = "method: none", during: Callable[[Any], None] = lambda _: None) -> Any:
        """Result of a part, and what the executive said meanwhile; ``during`` gets the feedback."""
        assert self.wait(self._action.server_is_ready)
        self.results.clear()
        self.scans.clear()
        self.states.clear()
        self.said: list[str] = []
        job = tiny_part(self.folder, springback)
        goal = FormPart.Goal(job_text=job.text, base_folder=str(job.base))

        def heard(message: Any) -> None:
            self.said.append(message.feedback.phase)
            during(message.feedback)

        sent = self._action.send_goal_async(goal, feedback_callback=heard)
        assert self.wait(sent.done)
        assert sent.result().accepted
        result = sent.result().get_result_async()
        assert self.wait(result.done)
        assert result.result().status in (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED)
        return result.result().result


def driver(level: int) -> AbstractContextManager[forked_process.Process]:
    return forked_process.node("-m", "isf_driver_example.driver_node", level=level, rate=RATE)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory, forked_nodes: None) -> Iterator[Cell]:
    """One for all drivers, one after the other."""
    folder = tmp_path_factory.mktemp("levels")
    rclpy.init()
    found = Cell(folder)
    try:
        with ProcessGroup(folder / "logs") as group:
            group.start("isf_planner", "planner", {})
            group.start("isf_springback", "springback", {})
            group.start("isf_force_ctrl", "force_ctrl", {"lockstep": False, **QUICK})
            group.start("isf_cell", "executive", {"lockstep": False, "service_timeout": 5.0})
            yield found
    finally:
        found.close()
        rclpy.try_shutdown()


def assert_formed(cell: Cell, result: Any) -> None:
    """The part is complete, and the support tool pressed as the job says, in the mean: a spring of 0.5 N/um that none
    of the nodes knows."""
    assert (result.code, result.message) == (0, ""), result.message
    assert len(cell.results) == result.contours == 2
    forces = np.concatenate([item.tick_normal_force[item.tick_engaged] for item in cell.results])
    assert forces.mean() == pytest.approx(SQUEEZED, abs=10.0)
    assert cell.infos[-1].world == -1  # a real machine
    assert cell.infos[-1].sheet == ""


def lifted_after(cell: Cell) -> set[int]:
    """Contours after which the tools were lifted off the sheet."""
    return {state.index for state in cell.states if state.mode == ForceCtrlState.LIFT}


def lines(cell: Cell) -> list[str]:
    """What the executive said of the driver."""
    return [line for line in cell.said if line.startswith(("no machine/", "the driver has no"))]


def test_without_a_driver_the_executive_says_what_is_missing(cell: Cell) -> None:
    result = cell.form()
    assert result.code == ErrorCode.NODE_MISSING
    assert "tool_1/pose" in result.message


def test_streams_alone(cell: Cell) -> None:
    with driver(1):
        result = cell.form()
        assert result.code == ErrorCode.NO_TARE
        assert "wrenches_tared:=true" in result.message
        assert cell.results == []
        with cell.wrenches_tared():
            assert_formed(cell, cell.form())
        assert [line.split(":")[0] for line in lines(cell)] == [
            "the driver has no lifecycle services",
            "no machine/reset",
            "no machine/tare",
            "no machine/state",
            "no machine/stop",
            "no machine/scan",
        ]
        assert cell.scans == []


def test_with_tare_and_stop_and_its_end_in_mid_part(cell: Cell) -> None:
    with driver(2) as process:
        assert_formed(cell, cell.form("method: none\n  scan_every: 1"))
        assert lifted_after(cell) == {1}, cell.said  # not for a scan that nobody makes
        assert [line.split(":")[0] for line in lines(cell)] == [
            "the driver has no lifecycle services",
            "no machine/reset",
            "no machine/scan",
        ]
        refused = cell.form("method: mpc_two_directional\n  scan_every: 1")
        assert refused.code == ErrorCode.SCAN_MISSING
        assert "machine/scan" in refused.message
        ended = cell.form(during=lambda m: process.kill() if m.phase == "forming" else None)
        assert ended.code == ErrorCode.NODE_DIED
        assert "'machine'" in ended.message
    missing = cell.form()  # the middleware still names what the killed one published and served
    assert missing.code == ErrorCode.NODE_MISSING, missing.message


def test_with_scans(cell: Cell) -> None:
    with driver(3):
        assert_formed(cell, cell.form("method: none\n  scan_every: 1"))
        assert lifted_after(cell) == {0, 1}, cell.said  # out of the scanner's sight
        assert [line.split(":")[0] for line in lines(cell)] == [
            "the driver has no lifecycle services",
            "no machine/reset",
        ]
        assert cell.wait(lambda: len(cell.scans) == 2)
        z = np.frombuffer(bytes(cell.scans[-1].data), dtype="<f4").reshape(-1, 3)[:, 2]
        assert -5e-3 < z.min() < -4e-3  # formed 5 mm deep, and sprung back


def test_with_lifecycle_and_a_second_of_silence_in_mid_part(cell: Cell) -> None:
    """A driver that stands still is waited for."""
    stopped: list[str] = []

    def stand_still(feedback: Any) -> None:
        if feedback.phase == "forming" and not stopped:
            stopped.append(feedback.phase)
            os.killpg(process.pid, signal.SIGSTOP)
            time.sleep(1.2)  # the fault itself: the tools stand after 30 ms of it, the part would end after 3 s
            os.killpg(process.pid, signal.SIGCONT)

    with driver(4) as process:
        assert_formed(cell, cell.form(during=stand_still))
        assert stopped
        assert any(state.flags & ForceCtrlState.PAUSED for state in cell.states)
        assert lines(cell) == []
        assert cell.wait(lambda: len(cell.scans) == 1)
