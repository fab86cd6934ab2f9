"""Node force_ctrl and what it talks to in processes of their own, and the node with which a test watches them."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import forked_process
import rclpy
from contact_sandbox import ring
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.errors import ErrorCode
from isf_core.files.yaml_file import find_named
from isf_msgs.msg import Contour, ContourResult, ForceCtrlState
from isf_msgs.srv import Arm
from isf_ros import conversion, qos, stamps
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from waiting import LIMIT, Waiting

Watcher = TypeVar("Watcher")

FOLDER = tempfile.TemporaryDirectory(prefix="isf_near_rig_")
RIG = Path(FOLDER.name) / "near.yaml"
"""The rig ren2018 with the tools parked near the sheet, so that they are there after few ticks. Tools count as free up
to 8 mm below that height, and the stand-in machine has its sheet from 15 mm on."""
_text = find_named("rigs", "ren2018").read_text(encoding="utf-8")
assert "park_height: 100 mm" in _text
RIG.write_text(_text.replace("park_height: 100 mm", "park_height: 25 mm"), encoding="utf-8")

JOB = f"""
name: ring
part: {{mesh: ring.stl, unit: mm}}
process: DSIF
rig: {RIG}
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{radius: 5 mm}}
tool_2: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
control: {{rate: 500 Hz, support_force: 120 N, compliance_compensation: 0.5}}
"""

FAR_JOB = JOB.replace(str(RIG), "ren2018")
"""By the clock: on a busy computer the tools may be late, and have to have left the sheet when they count as free."""

QUICK = {"acceleration": 2.0, "seam_speed": 1.0}
"""Parameters with which a small ring takes 2,200 ticks, not 4,900 as with the node's own; 3,400 with FAR_JOB."""


def small_ring(index: int = 0, count: int = 1, **changes: object) -> Any:
    return ring(index, count, radius=10e-3, points=60, **changes)


def long_ring(index: int = 0, count: int = 1) -> Any:
    """A contour that is still being formed when a test does something to it: 7 s of the machine's time in contact."""
    return small_ring(index, count, feed=6e-3)


class Cell:
    """The test's own node, and the two processes."""

    def __init__(self, waiting: Waiting, stack: ExitStack) -> None:
        self.node, self.wait, self.stack = waiting.node, waiting.until, stack
        node = self.node
        self.results: list[ContourResult] = []
        self.states: list[ForceCtrlState] = []
        self.job = JOB
        """Armed where no other one is given."""
        self.targets = 0
        self.newest_target = 0
        """ns, stamp of the newest target that has come."""
        self._contours = node.create_publisher(Contour, "contour/corrected", qos.LATCHED)
        node.create_subscription(ContourResult, "contour/result", self.results.append, qos.EVENT)
        # deep, since a mode may last ten states only and this process may be held up for longer
        node.create_subscription(ForceCtrlState, "force_ctrl/state", self.states.append, qos.STREAM_SOURCE)
        node.create_subscription(PoseStamped, "tool_1/target", self._count, qos.STREAM)
        self._arm = node.create_client(Arm, "force_ctrl/arm")

    def _count(self, message: PoseStamped) -> None:
        self.targets += 1
        self.newest_target = max(self.newest_target, stamps.to_nanoseconds(message.header.stamp))

    def start(
        self,
        machine: dict[str, object] | None = None,
        remap: dict[str, str] | None = None,
        program: tuple[str, ...] = ("-m", "isf_force_ctrl.node"),
        **parameters: object,
    ) -> None:
        here = Path(__file__)
        options: dict[str, Any] = machine or {}
        self.job = JOB if parameters.get("lockstep", True) else FAR_JOB
        self.stack.enter_context(forked_process.node(str(here.with_name("standin_machine.py")), remap=remap, **options))
        # as long as a busy computer may hold a process up
        values: dict[str, Any] = {"wrench_timeout": 60.0, **QUICK, **parameters}
        self.process = self.stack.enter_context(forked_process.node(*program, autostart=True, remap=remap, **values))
        assert self._arm.wait_for_service(LIMIT)

    def arm(
        self, plan_id: str = "plan", count: int = 1, support_force: float | None = None, job: str = ""
    ) -> Arm.Response:
        """Arm; asks again while wrenches and poses have not been discovered yet."""
        deadline = time.monotonic() + LIMIT
        while True:
            response = self.ask_to_arm(plan_id, count, support_force, job)
            if response.code not in (ErrorCode.WRENCH_LOST, ErrorCode.POSE_LOST) or time.monotonic() > deadline:
                return response

    def ask_to_arm(
        self,
        plan_id: str = "plan",
        count: int = 1,
        support_force: float | None = None,
        job: str = "",
        sheet: str = "",
    ) -> Arm.Response:
        """The answer to one request."""
        request = Arm.Request(plan_id=plan_id, count=count, job_text=job or self.job, sheet=sheet)
        if support_force is not None:
            request.support_force = support_force
        future = self._arm.call_async(request)
        assert self.wait(future.done)
        return future.result()

    def publish(self, contour: Any) -> None:
        self._contours.publish(conversion.contour_to_message(contour))

    def form(self, contour: Any, timeout: float = 3 * LIMIT) -> ContourResult:
        seen = len(self.results)
        self.publish(contour)
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


class Observed(Cell):
    """The cell, with the node's diagnostics, and parameters that can be set."""

    def __init__(self, waiting: Waiting, stack: ExitStack) -> None:
        super().__init__(waiting, stack)
        node = self.node
        self.health: dict[str, str] = {}
        self.message = ""
        self.newest_wrench = 0
        """ns, stamp of the wrench that came last."""
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)
        node.create_subscription(WrenchStamped, "tool_1/wrench", self._on_wrench, qos.STREAM)
        self._setters: dict[str, Any] = {}

    def _on_wrench(self, message: WrenchStamped) -> None:
        self.newest_wrench = stamps.to_nanoseconds(message.header.stamp)

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("force_ctrl"):
                self.health = {item.key: item.value for item in status.values}
                self.message = status.message

    def setter(self, name: str) -> Any:
        """Client that sets parameters of node ``name``, which it has found."""
        if name not in self._setters:
            self._setters[name] = self.node.create_client(SetParameters, f"{name}/set_parameters")
            assert self._setters[name].wait_for_service(LIMIT)
        return self._setters[name]

    def set(self, name: str, **values: object) -> list[Any]:
        """Results of setting parameters of node ``name``, one by one."""
        request = SetParameters.Request()
        request.parameters = [Parameter(key, value=value).to_parameter_msg() for key, value in values.items()]
        future = self.setter(name).call_async(request)
        assert self.wait(future.done)
        return list(future.result().results)


@contextmanager
def watched(kind: Callable[[Waiting, ExitStack], Watcher]) -> Iterator[Watcher]:
    """What ``kind`` makes of a node of its own; processes that it starts on its stack end with it."""
    rclpy.init()
    node = rclpy.create_node("observer")
    waiting = Waiting(node)
    try:
        with ExitStack() as stack:
            yield kind(waiting, stack)
    finally:
        waiting.close()
        node.destroy_node()
        rclpy.try_shutdown()


def call_action(
    cell: Cell,
    kind: Any,
    name: str,
    goal: Any,
    *,
    cancel_when: Callable[[Any], bool] | None = None,
    timeout: float = LIMIT,
) -> tuple[Any, list[Any]]:
    """Result and feedback of an action; cancelled as soon as ``cancel_when`` holds for a feedback."""
    client = ActionClient(cell.node, kind, name)
    assert client.wait_for_server(LIMIT)
    seen: list[Any] = []
    sent = client.send_goal_async(goal, feedback_callback=lambda message: seen.append(message.feedback))
    assert cell.wait(sent.done)
    assert sent.result().accepted
    result = sent.result().get_result_async()
    if cancel_when is not None:
        assert cell.wait(lambda: any(cancel_when(item) for item in seen), timeout)
        assert cell.wait(sent.result().cancel_goal_async().done)
    assert cell.wait(result.done, timeout)
    client.destroy()
    return result.result().result, seen
