"""Blocking calls to the nodes of a cell, for a worker thread: services, actions, parameters and lifecycle.

All with a watch that ends the wait.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from isf_core.errors import ErrorCode, IsfError, failure
from isf_ros.qos_match import UNKNOWN
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

ASK_AGAIN = 2.0
"""s without an answer, after which a question is asked again."""

POLL = 0.02
"""s between two looks at the watch function while waiting: what it sees has to stop the tools within 50 ms."""

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

    def prepare(self, services: Iterable[tuple[Any, str]]) -> None:
        """Make the clients of ``services`` (kind, name) now: a server drops its answer to a client that it has not
        discovered yet, and what changes something must not be asked for twice."""
        for kind, name in services:
            self._service(kind, name)

    def offers(self, kind: Any, name: str) -> bool:
        """True when somebody is known to serve the service ``name``."""
        return bool(self._service(kind, name).service_is_ready())

    def publishers(self, topic: str) -> int:
        """How many are known to publish ``topic``."""
        return int(self._node.count_publishers(self._node.resolve_topic_name(topic)))

    def publisher_names(self, topic: str) -> list[str]:
        """Full names of the nodes that are known to publish ``topic``; one that was started again counts once."""
        infos = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        return sorted({_full_name(info) for info in infos if info.node_name != UNKNOWN})

    def type_hashes(self, topic: str) -> dict[str, str]:
        """Hash of the type of ``topic`` with which each node that publishes or takes it works."""
        name = self._node.resolve_topic_name(topic)
        ends = [*self._node.get_publishers_info_by_topic(name), *self._node.get_subscriptions_info_by_topic(name)]
        return {_full_name(end): str(end.topic_type_hash) for end in ends if end.node_name != UNKNOWN}

    def call(self, kind: Any, name: str, request: Any, watch: Watch, *, timeout: float | None = None) -> Any:
        """Response of a service; raises IsfError NODE_MISSING (no server) or SERVICE_TIMEOUT."""
        client = self._ready(kind, name, watch)
        return self._await(client.call_async(request), watch, name, timeout)

    def ask(self, kind: Any, name: str, request: Any, watch: Watch) -> Any:
        """As :meth:`call`, for a request that may be made again: one without an answer is, and any answer counts."""
        client = self._ready(kind, name, watch)
        answered = threading.Event()
        asked: list[Future] = []
        deadline = time.monotonic() + self._timeout
        try:
            while True:
                asked.append(client.call_async(request))
                asked[-1].add_done_callback(lambda _: answered.set())
                again = time.monotonic() + min(ASK_AGAIN, self._timeout)
                while not answered.wait(POLL) and time.monotonic() <= again:
                    watch()
                if answered.is_set():
                    return next(future for future in asked if future.done()).result()
                if time.monotonic() > deadline:
                    raise self._silent(name, self._timeout)
        finally:
            for future in asked:
                future.cancel()

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
        self.wait_until(client.server_is_ready, watch, f"action '{name}' is not available", ErrorCode.NODE_MISSING)
        handle = self._asked(
            lambda: client.send_goal_async(goal, feedback_callback=lambda message: on_feedback(message.feedback)),
            watch,
            name,
        )
        if not handle.accepted:
            raise IsfError(ErrorCode.BUSY, f"'{name}' refused the goal", advice="wait until its present goal ends")
        try:
            return self._asked(handle.get_result_async, watch, name, timeout).result
        except IsfError:
            handle.cancel_goal_async()
            raise

    def set_parameter(self, node_name: str, name: str, text: str, watch: Watch) -> None:
        """Set a string parameter of another node; raises the reason of a refusal."""
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        response = self.ask(SetParameters, f"{node_name}/set_parameters", request, watch)
        if not response.results[0].successful:
            raise IsfError(ErrorCode.METHOD_UNKNOWN, response.results[0].reason)

    def get_parameter(self, node_name: str, name: str, watch: Watch) -> Any:
        """Value of a parameter of another node; None when it has none of that name."""
        response = self.ask(GetParameters, f"{node_name}/get_parameters", GetParameters.Request(names=[name]), watch)
        return parameter_value_to_python(response.values[0]) if response.values else None

    def state_of(self, node_name: str, watch: Watch) -> int:
        """Lifecycle state id of a node."""
        return int(self.ask(GetState, f"{node_name}/get_state", GetState.Request(), watch).current_state.id)

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
        self,
        condition: Callable[[], bool],
        watch: Watch,
        what: str,
        code: ErrorCode,
        *,
        timeout: float | None = None,
        advice: str = "see isf doctor and the log of the node",
    ) -> None:
        """Wait for a condition; raises IsfError ``code`` with ``what`` and ``advice`` after the timeout."""
        if not self.within(timeout or self._timeout, condition, watch):
            raise IsfError(code, what, advice=advice)

    def within(self, seconds: float, condition: Callable[[], bool], watch: Watch) -> bool:
        """True as soon as the condition holds, False when it did not within ``seconds``."""
        deadline = time.monotonic() + seconds
        pause = threading.Event()
        while not condition():
            watch()
            if time.monotonic() > deadline:
                return False
            pause.wait(POLL)
        return True

    def _service(self, kind: Any, name: str) -> Any:
        return self._clients.get(name) or self._clients.setdefault(name, self._node.create_client(kind, name))

    def _ready(self, kind: Any, name: str, watch: Watch) -> Any:
        client = self._service(kind, name)
        self.wait_until(client.service_is_ready, watch, f"service '{name}' is not available", ErrorCode.NODE_MISSING)
        return client

    def _transition(self, node_name: str, transition: int, label: str, watch: Watch) -> None:
        request = ChangeState.Request(transition=Transition(id=transition))
        # configure may load and compile; it is bounded, but not by the time of an ordinary answer
        response = self.call(ChangeState, f"{node_name}/change_state", request, watch, timeout=6 * self._timeout)
        if not response.success:
            raise IsfError(
                ErrorCode.TRANSITION_FAILED, f"'{node_name}' could not {label}", advice="its reason is in /diagnostics"
            )

    def _asked(self, ask: Callable[[], Future], watch: Watch, name: str, timeout: float | None = None) -> Any:
        """Answer to what ``ask`` sends to an action. It is called in the thread of the executor: rclpy notes what it
        sent to an action only afterwards, and an answer that its executor takes in between is lost."""
        sent = self._await(self._node.executor.create_task(ask), watch, name)
        return self._await(sent, watch, name, timeout)

    def _await(self, future: Future, watch: Watch, name: str, timeout: float | None = None) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        limit = timeout or self._timeout
        deadline = time.monotonic() + limit
        while not done.wait(POLL):
            watch()
            if time.monotonic() > deadline:
                future.cancel()
                raise self._silent(name, limit)
        return future.result()

    @staticmethod
    def _silent(name: str, limit: float) -> IsfError:
        return IsfError(ErrorCode.SERVICE_TIMEOUT, f"'{name}' did not answer within {limit:g} s")


def _full_name(end: Any) -> str:
    return f"{end.node_namespace.rstrip('/')}/{end.node_name}"
