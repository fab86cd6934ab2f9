"""Node force_ctrl in its own process against a stand-in machine in another, over real DDS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from contact_sandbox import ring
from geometry_msgs.msg import PoseStamped
from isf_core.contour import Process
from isf_core.errors import ErrorCode
from isf_msgs.msg import Contour, ContourResult, ForceCtrlState
from isf_msgs.srv import Arm
from isf_node import conversion, qos
from rclpy.node import Node
from std_srvs.srv import Trigger

pytestmark = pytest.mark.graph

LIMIT = 120.0
"""s; only to end a test that hangs: a process may take long to start."""

JOB = """
name: ring
part: {mesh: ring.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz, support_force: 120 N, compliance_compensation: 0.5}
"""


@contextmanager
def started(
    *command: str, remap: dict[str, str] | None = None, **parameters: object
) -> Iterator[subprocess.Popen[bytes]]:
    arguments = [sys.executable, *command, "--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    for name, new in (remap or {}).items():
        arguments += ["-r", f"{name}:={new}"]
    process = subprocess.Popen(arguments, start_new_session=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
        process.wait(LIMIT)


class Cell:
    """The test's own node, and the two processes."""

    def __init__(self, node: Node, stack: ExitStack) -> None:
        self.node, self._stack = node, stack
        self.results: list[ContourResult] = []
        self.states: list[ForceCtrlState] = []
        self.targets = 0
        self._contours = node.create_publisher(Contour, "contour/corrected", qos.LATCHED)
        node.create_subscription(ContourResult, "contour/result", self.results.append, qos.EVENT)
        # deep, since a mode may last ten states only and this process may be held up for longer
        node.create_subscription(ForceCtrlState, "force_ctrl/state", self.states.append, qos.STREAM_SOURCE)
        node.create_subscription(PoseStamped, "tool_1/target", self._count, qos.STREAM)
        self._arm = node.create_client(Arm, "force_ctrl/arm")

    def _count(self, _: PoseStamped) -> None:
        self.targets += 1

    def start(
        self, machine: dict[str, object] | None = None, remap: dict[str, str] | None = None, **parameters: object
    ) -> None:
        here = Path(__file__)
        options: dict[str, Any] = machine or {}
        self._stack.enter_context(started(str(here.with_name("standin_machine.py")), remap=remap, **options))
        # as long as a busy computer may hold a process up
        values: dict[str, Any] = {"wrench_timeout": 60.0, **parameters}
        self._stack.enter_context(started("-m", "isf_force_ctrl.node", autostart=True, remap=remap, **values))
        assert self._arm.wait_for_service(LIMIT)

    def wait(self, condition: Callable[[], Any], timeout: float = LIMIT) -> bool:
        deadline = time.monotonic() + timeout
        while not condition() and time.monotonic() < deadline:
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return bool(condition())

    def arm(
        self, plan_id: str = "plan", count: int = 1, support_force: float = float("nan"), job: str = JOB
    ) -> Arm.Response:
        """Arm; asks again while the wrenches have not been discovered yet."""
        request = Arm.Request(plan_id=plan_id, count=count, job_text=job, support_force=support_force)
        deadline = time.monotonic() + LIMIT
        while True:
            future = self._arm.call_async(request)
            assert self.wait(future.done)
            response = future.result()
            if response.code != ErrorCode.WRENCH_LOST or time.monotonic() > deadline:
                return response

    def form(self, contour: Any, timeout: float = 3 * LIMIT) -> ContourResult:
        seen = len(self.results)
        self._contours.publish(conversion.contour_to_message(contour))
        assert self.wait(lambda: len(self.results) > seen, timeout)
        return self.results[-1]

    def rests_in(self, mode: int) -> bool:
        """Wait until the newest state has ``mode``."""
        return self.wait(lambda: self.states and self.states[-1].mode == mode)

    def armed(self, **options: Any) -> None:
        deadline = time.monotonic() + LIMIT
        response = self.arm(**options)
        while (
            response.code == ErrorCode.NO_TARE and time.monotonic() < deadline
        ):  # machine/state comes ten times a second
            response = self.arm(**options)
        assert (response.code, response.message) == (0, "")


@pytest.fixture
def cell() -> Iterator[Cell]:
    rclpy.init()
    node = rclpy.create_node("observer")
    with ExitStack() as stack:
        yield Cell(node, stack)
    node.destroy_node()
    rclpy.try_shutdown()


def small_ring(index: int = 0, count: int = 1) -> Any:
    return ring(index, count, radius=10e-3, points=60)


def test_forms_a_part_in_lockstep(cell: Cell) -> None:
    cell.start()
    cell.armed(count=2)
    for index in range(2):
        result = conversion.result_from_message(cell.form(small_ring(index, 2)))
        assert (result.completed, result.code, result.index) == (True, 0, index)
        force = result.tick_normal_force[result.tick_engaged]
        # The sandbox's force is constant but for noise of 1.2 N and steps of 1 N.
        assert np.mean(np.abs(force - 120.0) <= 10.0) >= 0.99
        assert result.lost_messages == 0
        assert np.diff(result.tick_time) == pytest.approx(0.002, abs=1e-6)
    assert cell.rests_in(ForceCtrlState.IDLE)
    modes = {state.mode for state in cell.states}
    assert {ForceCtrlState.ENGAGE, ForceCtrlState.CONTROL, ForceCtrlState.LIFT} <= modes
    # Parked: nothing is streamed any more, not even repeated.
    cell.wait(lambda: False, 0.5)
    before = cell.targets
    cell.wait(lambda: False, 0.7)
    assert cell.targets == before


def test_nan_wrench_holds_with_its_code(cell: Cell) -> None:
    cell.start({"nan_at": 1000})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_NOT_FINITE)
    assert cell.rests_in(ForceCtrlState.HOLD)
    before = cell.targets
    assert cell.wait(lambda: cell.targets > before + 2)  # still alive: the last targets are repeated


def test_wrenches_that_stop_end_the_contour(cell: Cell) -> None:
    cell.start({"silent_at": 1000}, wrench_timeout=1.0)
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_LOST)
    assert "machine" in result.message


def test_refusals(cell: Cell) -> None:
    cell.start({"tared": False})
    cell._contours.publish(conversion.contour_to_message(small_ring()))
    response = cell.arm()
    deadline = time.monotonic() + LIMIT
    assert response.code == ErrorCode.NO_TARE
    while "not tared" not in response.message and time.monotonic() < deadline:
        response = cell.arm()
    assert cell.targets == 0  # the contour came before anything was armed
    assert cell.results == []
    disarmed = cell.arm(plan_id="")
    assert disarmed.code == 0


def test_contours_out_of_order_are_answered(cell: Cell) -> None:
    cell.start()
    cell.armed(count=3)
    result = cell.form(small_ring(1, 3))
    assert (result.completed, result.code, result.index) == (False, ErrorCode.CONTOUR_REJECTED, 1)
    assert cell.targets == 0


def test_stop_and_disarm(cell: Cell) -> None:
    cell.start()
    cell.armed()
    client = cell.node.create_client(Trigger, "force_ctrl/stop")
    assert client.wait_for_service(LIMIT)
    cell._contours.publish(conversion.contour_to_message(small_ring()))
    assert cell.wait(lambda: any(state.mode == ForceCtrlState.APPROACH for state in cell.states))
    assert cell.wait(client.call_async(Trigger.Request()).done)
    assert cell.wait(lambda: cell.results)
    assert cell.results[-1].code == ErrorCode.STOPPED
    assert cell.arm(plan_id="").code == 0
    assert cell.rests_in(ForceCtrlState.IDLE)


def test_real_time_forms_a_contour(cell: Cell) -> None:
    cell.start({"lockstep": False}, lockstep=False)
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    # Timing depends on the machine the test runs on; forming and counting must work on any.
    assert (result.completed, result.code) == (True, 0)
    assert result.contact_fraction > 0.9
    assert len(result.tick_time) > 500


def test_a_driver_with_other_topic_names(cell: Cell) -> None:
    # docs/other_cells.md: the node alone against a driver that follows a stream of poses under names of its own
    names = {
        "tool_1/target": "left/target_frame",
        "tool_1/wrench": "left/ft_sensor_wrench",
        "tool_2/target": "right/target_frame",
        "tool_2/wrench": "right/ft_sensor_wrench",
    }
    cell.start(remap=names)
    frames: list[PoseStamped] = []
    cell.node.create_subscription(PoseStamped, "left/target_frame", frames.append, qos.STREAM)
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    assert (result.completed, result.code) == (True, 0)
    assert cell.targets == 0
    assert {frame.header.frame_id for frame in frames} == {"sheet"}


def test_latency_is_measured(cell: Cell) -> None:
    cell.start()
    cell.armed()
    cell.form(small_ring())
    latency = np.array([state.latency for state in cell.states if state.mode == ForceCtrlState.CONTROL])
    assert latency.size
    assert np.isfinite(latency).all()
    assert (latency > 0.0).all()


def test_saturated_cell_holds_with_its_code(cell: Cell) -> None:
    cell.start({"saturated_at": 1000})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_OUT_OF_RANGE)
    assert "tool_2" in result.message or "tool_1" in result.message


def test_a_fifth_of_the_wrenches_may_be_lost_in_real_time(cell: Cell) -> None:
    cell.start({"lockstep": False, "lost_share": 0.2}, lockstep=False)
    cell.armed()
    result = conversion.result_from_message(cell.form(small_ring()))
    assert (result.completed, result.code) == (True, 0)
    assert result.contact_fraction > 0.9


def test_contour_for_one_tool_is_answered(cell: Cell) -> None:
    cell.start()
    cell.armed()
    contour = replace(small_ring(), support_tip=np.empty((0, 3)), support_force=np.empty(0))
    result = cell.form(contour)
    assert (result.completed, result.code) == (False, ErrorCode.CONTOUR_REJECTED)
    assert "one tool only" in result.message
    assert cell.targets == 0


def test_blank_holder_has_targets_in_tpif(cell: Cell) -> None:
    cell.start()
    heights: list[float] = []
    cell.node.create_subscription(
        PoseStamped, "holder/target", lambda message: heights.append(message.pose.position.z), qos.STREAM
    )
    job = JOB.replace("DSIF", "TPIF").replace("support_force: 120 N, ", "") + "die: {mesh: die.stl, unit: mm}\n"
    cell.armed(job=job)
    nothing = np.empty((0, 3))
    contour = replace(
        small_ring(), process=Process.TPIF, support_tip=nothing, support_force=np.empty(0), holder_height=1e-3
    )
    result = cell.form(contour)
    assert (result.completed, result.code) == (True, 0)
    assert cell.wait(lambda: heights and max(heights) > 0.0 and heights[-1] == 0.0)
    assert max(heights) == pytest.approx(1e-3)  # and down again when parked


def test_wrenches_in_another_frame_are_refused(cell: Cell) -> None:
    cell.start({"frame": "tool0"})
    response = cell.arm()
    deadline = time.monotonic() + LIMIT
    while response.code == ErrorCode.NO_TARE and time.monotonic() < deadline:
        response = cell.arm()
    assert response.code == ErrorCode.WRENCH_FRAME
    assert "'tool0', not 'sheet'" in response.message
    assert cell.targets == 0


def test_a_frozen_wrench_holds_with_its_code(cell: Cell) -> None:
    cell.start({"frozen_at": 1500})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.WRENCH_FROZEN)
    assert cell.rests_in(ForceCtrlState.HOLD)


def test_a_cell_with_the_wrong_sign_holds_with_its_code(cell: Cell) -> None:
    cell.start({"sign": -1.0})
    cell.armed()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.LOAD_CELL_SIGN)
