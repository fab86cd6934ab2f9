"""A client of a running cell for an operator: mode, pause, movement by hand, work offsets."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import rclpy
from geometry_msgs.msg import Point, Vector3
from isf_core.errors import ErrorCode, IsfError, failure, told
from isf_msgs.action import MoveTo
from isf_msgs.msg import ExecutiveState, HandState, Jog
from isf_msgs.srv import SetMode, SetZero
from isf_ros import qos
from isf_ros.process import join_graph
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from isf_cell.processes.cell_nodes import operator_arguments
from isf_cell.processes.ctrl_c import ctrl_c_held_back
from isf_cell.run.served import Served

CELL = "start a cell in this ROS domain: isf cell JOB"
PART = "no part is formed in this ROS domain; start one: isf form JOB"

START, CHANGE, STOPPED = 10.0, 300.0, 5.0
"""s: what is asked must be there; a mode brings up nodes; a movement that was cancelled has ended."""

AT_REST = 1.0
"""s for force_ctrl to tell that nothing is pressed; somebody else may have the tools."""

HISTORY = 0.2
"""s, longest pause between the states that a subscriber is told of the time before it."""

PERIOD = 0.04
"""s between two jog messages, of the 0.15 s after which a button counts as let go."""


class HandClient:
    """For one thread; a context manager."""

    def __init__(self) -> None:
        join_graph(operator_arguments())
        self.name = f"isf_{os.getpid()}"
        self._node = Node(f"isf_hand_{os.getpid()}")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.executive: ExecutiveState | None = None
        """What the executive told last."""
        self.hand: HandState | None = None
        """What force_ctrl told last of movement by hand."""
        self._node.create_subscription(ExecutiveState, "executive/state", self._on_executive, qos.CHANGES)
        self._node.create_subscription(HandState, "force_ctrl/hand", self._on_hand, qos.CHANGES)
        self._jog = self._node.create_publisher(Jog, "jog", qos.STREAM)
        self._move = ActionClient(self._node, MoveTo, "move_to")
        self._next = 0.0

    def __enter__(self) -> HandClient:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.remove_node(self._node)
        self._move.destroy()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def set_mode(self, mode: int, job_text: str = "", base_folder: str = "", *, new_blank: bool = False) -> None:
        """Change the mode, a constant of ExecutiveState; raises IsfError of the executive, NODE_MISSING."""
        request = SetMode.Request(mode=mode, job_text=job_text, base_folder=base_folder, new_blank=new_blank)
        self._call(SetMode, "executive/set_mode", request, CHANGE, advice=CELL)

    def state(self) -> ExecutiveState:
        """What the executive tells; raises IsfError NODE_MISSING."""
        if not self._wait(lambda: self.executive is not None, START) or self.executive is None:
            raise _missing("nothing on executive/state", CELL)
        states = [self.executive]
        while self._wait(lambda: self.executive is not states[-1], HISTORY):  # the newest comes after those before it
            states.append(self.executive)
        return states[-1]

    def pause(self, paused: bool) -> str:
        """Let the part wait after its present contour, or go on, whatever it waits for; returns what the executive
        says. Raises IsfError MODE_REFUSED (no part is formed), NODE_MISSING."""
        request = SetBool.Request(data=paused)
        return str(self._call(SetBool, "executive/pause", request, START, advice=PART).message)

    def zero(self, system: int, tool: int, axes: str) -> Any:
        """Response of ``executive/zero``; raises IsfError of the executive, NODE_MISSING."""
        return self._call(SetZero, "executive/zero", SetZero.Request(system=system, tool=tool, axes=axes), START)

    def move_to(
        self, tool: int, position: Sequence[float], speed: float, progress: Callable[[float], None]
    ) -> tuple[float, float, float]:
        """Move a tip to ``position`` (3,) m with ``speed`` m/s; returns where it is commanded to be then.

        It moves as long as this client publishes; Ctrl-C cancels. ``progress`` is told m to go. Raises IsfError,
        NODE_DIED when force_ctrl is gone.
        """
        if not self._wait(self._move.server_is_ready, START):
            raise _missing("no node serves the action 'move_to'")
        x, y, z = position
        goal = MoveTo.Goal(tool=tool, position=Point(x=x, y=y, z=z), speed=speed, client=self.name)
        sent: Future = self._move.send_goal_async(goal, lambda message: progress(message.feedback.left))
        held, served = self._held(tool), Served(self._move.server_is_ready, "force_ctrl")

        def alive() -> None:
            held()
            served.check()

        if not self._wait(sent.done, START, alive) or not sent.result().accepted:
            raise IsfError(ErrorCode.BUSY, "force_ctrl refused the goal", where="move_to", advice="is the node active?")
        result: Future = sent.result().get_result_async()
        try:
            self._wait(result.done, float("inf"), alive)
        except KeyboardInterrupt:
            sent.result().cancel_goal_async()
            with suppress(KeyboardInterrupt):
                self._wait(result.done, STOPPED)
            raise
        found = result.result().result
        if found.code:
            raise failure(found.code, found.message)
        return found.position.x, found.position.y, found.position.z

    def step(self, tool: int, direction: Sequence[float], increment: float, speed: float) -> None:
        """One step of ``increment`` m along ``direction`` (3,); returns when the tool stands; raises IsfError.

        On a busy computer a message may come so late that the key counts as let go, before anything moved. Then it is
        pressed again: what was pressed until then moves nothing.
        """
        if not self._wait(lambda: self.hand is not None and self._jog.get_subscription_count() > 0, START):
            raise _missing("nothing on force_ctrl/hand")
        if self.hand is None or not self.hand.armed:
            raise IsfError(
                ErrorCode.NOT_ARMED, "force_ctrl is not armed by hand", where="jog", advice="isf mode manual"
            )
        message = Jog(client=self.name, enable=True, tool=tool, increment=increment, speed=speed)
        rest = Jog(client=self.name, enable=True, tool=tool, increment=increment, speed=speed)
        message.direction = Vector3(**dict(zip("xyz", map(float, direction), strict=True)))
        seen: list[HandState] = []
        self._watch = seen.append
        deadline = time.monotonic() + START + increment / max(speed, 1e-4)

        def ended() -> bool:
            mine = [state for state in seen if state.client == self.name and (state.moving or state.code)]
            taken = [state for state in seen if state.code == ErrorCode.HAND_TAKEN]
            return bool(mine or taken) and not seen[-1].moving

        def at_rest() -> bool:
            """The tools are this client's, who presses nothing, and nothing is told of what was before."""
            return bool(seen) and seen[-1].client == self.name and not (seen[-1].moving or seen[-1].code)

        try:
            while True:
                seen.clear()
                self._jog.publish(Jog(client=self.name, enable=False, tool=tool))
                self._wait(at_rest, AT_REST, self._sender(rest))
                before = self.hand
                seen.clear()
                if not self._wait(ended, deadline - time.monotonic(), self._sender(message)):
                    what = "the step was not made"
                    raise IsfError(ErrorCode.SERVICE_TIMEOUT, what, where="jog", advice="see the log of force_ctrl")
                last = seen[-1]
                stood = (last.tip_1, last.tip_2) == (before.tip_1, before.tip_2)
                if last.code != ErrorCode.HAND_LOST or not stood:
                    break
        finally:
            self._watch = None
            self._jog.publish(Jog(client=self.name, enable=False, tool=tool))
        if seen[-1].code:
            raise failure(seen[-1].code, seen[-1].message)

    # -- inside ----------------------------------------------------------------------------------

    _watch: Callable[[HandState], None] | None = None

    def _on_executive(self, message: ExecutiveState) -> None:
        self.executive = message

    def _on_hand(self, message: HandState) -> None:
        self.hand = message
        if self._watch is not None:
            self._watch(message)

    def _held(self, tool: int) -> Callable[[], None]:
        return self._sender(Jog(client=self.name, enable=True, tool=tool))

    def _sender(self, message: Jog) -> Callable[[], None]:
        """Publishes ``message`` again and again, when it is called often."""

        def send() -> None:
            if time.monotonic() >= self._next:
                self._next = time.monotonic() + PERIOD
                message.header.stamp = self._node.get_clock().now().to_msg()
                self._jog.publish(message)

        return send

    def _call(self, kind: Any, name: str, request: Any, timeout: float, *, advice: str | None = None) -> Any:
        client = self._node.create_client(kind, name)
        try:
            if not self._wait(client.service_is_ready, START):
                raise _missing(f"no node serves '{name}'", advice)
            asked: Future = client.call_async(request)
            if not self._wait(asked.done, timeout):
                raise IsfError(ErrorCode.SERVICE_TIMEOUT, f"'{name}' did not answer within {timeout:g} s")
            response = asked.result()
        finally:
            self._node.destroy_client(client)
        if not getattr(response, "success", True):  # of std_srvs
            raise told(response.message) or IsfError(ErrorCode.MODE_REFUSED, response.message, where=name)
        if getattr(response, "code", 0):
            raise failure(response.code, response.message)
        return response

    def _wait(self, condition: Callable[[], bool], timeout: float, each: Callable[[], None] | None = None) -> bool:
        deadline = time.monotonic() + timeout
        with ctrl_c_held_back() as let_ctrl_c_through:
            while not condition() and time.monotonic() < deadline:
                let_ctrl_c_through()
                if each is not None:
                    each()
                self._executor.spin_once(timeout_sec=0.02)
        return condition()


def _missing(what: str, advice: str | None = None) -> IsfError:
    return IsfError(ErrorCode.NODE_MISSING, what, advice=advice or f"{CELL}, then: isf mode manual")
