"""The cell through the node graph: blocking calls to its nodes, and the tool lift and the scan between two contours.

For a worker thread: services, actions, parameters and lifecycle, all with a watch that ends the wait. Lift and scan are
the actions of force_ctrl and the service of the machine; the counterpart is :mod:`isf_cell.run.in_process_cell`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from isf_core.contour import ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_msgs.action import LiftTool, MoveAside
from isf_msgs.srv import Scan
from isf_ros import stamps
from isf_ros.conversion import lift_to_cloud
from isf_ros.lifecycle import failure
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2

from isf_cell.run.in_process_cell import NO_ROWS, SETTINGS, lift_rows, tools_aside

POLL = 0.05
"""s between two looks at the watch function while waiting."""

Watch = Callable[[], None]


class GraphClient:
    """Clients of the services and actions that a part needs, made once and reused."""

    def __init__(self, node: Node, timeout: float) -> None:
        self._node = node
        self._timeout = timeout
        self._clients: dict[str, Any] = {}

    def close(self) -> None:
        """Leave the graph: destroy every client."""
        for client in self._clients.values():
            if isinstance(client, ActionClient):
                client.destroy()
            else:
                self._node.destroy_client(client)
        self._clients.clear()

    def call(self, kind: Any, name: str, request: Any, watch: Watch, *, timeout: float | None = None) -> Any:
        """Response of a service; raises IsfError NODE_MISSING (no server) or SERVICE_TIMEOUT."""
        client = self._clients.get(name) or self._clients.setdefault(name, self._node.create_client(kind, name))
        self.wait_until(client.service_is_ready, watch, f"service '{name}' is not there", ErrorCode.NODE_MISSING)
        return self._await(client.call_async(request), watch, name, timeout)

    def checked_call(self, kind: Any, name: str, request: Any, watch: Watch, *, timeout: float | None = None) -> Any:
        """As :meth:`call`, and raises the IsfError of a response whose ``code`` is not 0."""
        response = self.call(kind, name, request, watch, timeout=timeout)
        if response.code:
            raise failure(response.code, response.message)
        return response

    def run_action(
        self, kind: Any, name: str, goal: Any, watch: Watch, on_feedback: Callable[[Any], None], *, timeout: float
    ) -> Any:
        """Result of an action; cancels it when the watch raises."""
        client = self._clients.get(name) or self._clients.setdefault(name, ActionClient(self._node, kind, name))
        self.wait_until(client.server_is_ready, watch, f"action '{name}' is not there", ErrorCode.NODE_MISSING)
        handle = self._await(
            client.send_goal_async(goal, feedback_callback=lambda message: on_feedback(message.feedback)), watch, name
        )
        if not handle.accepted:
            raise IsfError(ErrorCode.BUSY, f"'{name}' refused the goal", advice="wait until its present goal ends")
        try:
            return self._await(handle.get_result_async(), watch, name, timeout).result
        except IsfError:
            handle.cancel_goal_async()
            raise

    def set_parameter(self, node_name: str, name: str, text: str, watch: Watch) -> None:
        """Set a string parameter of another node; raises the reason of a refusal."""
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        response = self.call(SetParameters, f"{node_name}/set_parameters", request, watch)
        if not response.results[0].successful:
            raise IsfError(ErrorCode.METHOD_UNKNOWN, response.results[0].reason)

    def state_of(self, node_name: str, watch: Watch) -> int:
        """Lifecycle state id of a node."""
        return int(self.call(GetState, f"{node_name}/get_state", GetState.Request(), watch).current_state.id)

    def bring_up(self, node_name: str, watch: Watch) -> None:
        """Configure and activate a node; raises IsfError TRANSITION_FAILED."""
        if self.state_of(node_name, watch) == State.PRIMARY_STATE_UNCONFIGURED:
            self._transition(node_name, Transition.TRANSITION_CONFIGURE, "configure", watch)
        if self.state_of(node_name, watch) == State.PRIMARY_STATE_INACTIVE:
            self._transition(node_name, Transition.TRANSITION_ACTIVATE, "activate", watch)

    def bring_down(self, node_name: str, watch: Watch) -> None:
        """Deactivate a node when it is active."""
        if self.state_of(node_name, watch) == State.PRIMARY_STATE_ACTIVE:
            self._transition(node_name, Transition.TRANSITION_DEACTIVATE, "deactivate", watch)

    def wait_until(
        self, condition: Callable[[], bool], watch: Watch, what: str, code: ErrorCode, *, timeout: float | None = None
    ) -> None:
        """Wait for a condition; raises IsfError ``code`` with ``what`` after the timeout."""
        deadline = time.monotonic() + (timeout or self._timeout)
        pause = threading.Event()
        while not condition():
            watch()
            if time.monotonic() > deadline:
                raise IsfError(code, what, advice="see isf doctor and the log of the node")
            pause.wait(POLL)

    def _transition(self, node_name: str, transition: int, label: str, watch: Watch) -> None:
        request = ChangeState.Request(transition=Transition(id=transition))
        # configure may load and compile; it is bounded, but not by the time of an ordinary answer
        response = self.call(ChangeState, f"{node_name}/change_state", request, watch, timeout=6 * self._timeout)
        if not response.success:
            raise IsfError(
                ErrorCode.TRANSITION_FAILED, f"'{node_name}' could not {label}", advice="its reason is in /diagnostics"
            )

    def _await(self, future: Future, watch: Watch, name: str, timeout: float | None = None) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        limit = timeout or self._timeout
        deadline = time.monotonic() + limit
        while not done.wait(POLL):
            watch()
            if time.monotonic() > deadline:
                future.cancel()
                raise IsfError(ErrorCode.SERVICE_TIMEOUT, f"'{name}' did not answer within {limit:g} s")
        return future.result()


def lift_in_graph(
    client: GraphClient, watch: Watch, result: ContourResult, timeout: float, tell: Callable[[str], None]
) -> PointCloud2:
    """Lift the tool after the contour of ``result``; the message for ``tool_lift``, without points when it failed.

    Raises
    ------
    IsfError : NODE_DIED, CANCELLED; every other failure is told, and the part goes on without
    """
    goal = LiftTool.Goal(speed=SETTINGS.speed, zero_force=SETTINGS.zero_force, max_lift=SETTINGS.max_lift)
    rows = NO_ROWS
    try:
        found = client.run_action(LiftTool, "lift_tool", goal, watch, lambda _: None, timeout=timeout)
        if found.code:
            tell(f"the tool lift after {contour_label(result.index)} failed: {found.message}")
        else:
            rows = lift_rows(
                result, found.springback, found.force, np.asarray(found.lift_z), np.asarray(found.lift_force)
            )
    except IsfError as error:
        if error.code in (ErrorCode.NODE_DIED, ErrorCode.CANCELLED):
            raise
        tell(f"no tool lift after {contour_label(result.index)}: {error}")
    return lift_to_cloud(rows, stamps.from_seconds(result.end))


def scan_in_graph(
    client: GraphClient,
    watch: Watch,
    job_file: JobFile,
    index: int,
    timeout: float,
    tell: Callable[[str], None],
    *,
    closed: bool,
) -> None:
    """Measure the shape after contour ``index``, ``closed`` or not, for springback; ``timeout`` s of the tools' move.

    Tools that cannot be moved aside and a scanner that fails are told, and the part goes on with what there is.

    Raises
    ------
    IsfError : NODE_DIED, CANCELLED
    """
    after = contour_label(index)
    if tools_aside(job_file, closed=closed):
        try:
            moved = client.run_action(MoveAside, "move_aside", MoveAside.Goal(), watch, lambda _: None, timeout=timeout)
            if moved.code:
                tell(f"the tools were not moved aside after {after}: {moved.message}")
        except IsfError as error:
            _unless_over(error)
            tell(f"the tools were not moved aside after {after}: {error}")
    request = Scan.Request(clamped=True, sensor=job_file.job.springback.scan_sensor)
    try:
        client.checked_call(Scan, "machine/scan", request, watch)
    except IsfError as error:
        _unless_over(error)
        tell(f"no scan after {after}: {error}")


def _unless_over(error: IsfError) -> None:
    if error.code in (ErrorCode.NODE_DIED, ErrorCode.CANCELLED):
        raise error
