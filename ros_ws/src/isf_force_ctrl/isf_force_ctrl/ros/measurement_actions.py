"""Actions of node ``force_ctrl`` between contours: ``lift_tool`` measures, ``move_aside`` makes room for a scan."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_msgs.action import LiftTool, MoveAside
from isf_ros.background import in_thread
from isf_ros.lifecycle import CellNode
from rclpy.action.server import ServerGoalHandle

from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.measurements.tool_lift import LiftSettings, lift_tool

PERIOD = 0.1
"""s of wall time between two feedback messages."""


class MeasurementActions:
    """Serves the actions for ``node``.

    ``controller`` gives the present controller (None: nothing was armed), ``begun`` is called with the lock held when a
    measurement or a move begins, so that the first targets go out, and ``moving`` is true until a move has ended.
    """

    def __init__(
        self,
        node: CellNode[Any],
        lock: threading.RLock,
        controller: Callable[[], ForceController | None],
        begun: Callable[[], None],
        moving: Callable[[ForceController], bool],
    ) -> None:
        self._node, self._lock, self._controller, self._begun = node, lock, controller, begun
        self._moving = moving
        node.create_action_server(LiftTool, "lift_tool", self._lift_tool, lambda _: node.is_active)
        node.create_action_server(MoveAside, "move_aside", self._move_aside, lambda _: node.is_active)

    async def _lift_tool(self, handle: ServerGoalHandle) -> LiftTool.Result:
        goal = handle.request
        try:
            controller = self._armed("lift_tool")
            with self._lock:
                lift = lift_tool(controller, LiftSettings(goal.speed, goal.zero_force, goal.max_lift))
                self._begun()
        except IsfError as error:
            self._node.report(error)
            handle.abort()
            return LiftTool.Result(code=int(error.code), message=error.message)

        def notify() -> None:
            handle.publish_feedback(LiftTool.Feedback(lift=lift.lift, force=lift.force))

        await in_thread(
            lambda: follow(handle, lambda: self._moving(controller), controller.cancel, self._lock, notify),
            self._node.executor,
        )
        found = lift.record()
        result = LiftTool.Result(code=int(lift.code), message=lift.message)
        result.springback, result.force = found.springback, found.force
        result.lift_z, result.lift_force = found.lift_z.tolist(), found.lift_force.tolist()
        if lift.code is ErrorCode.OK:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            self._node.report(IsfError(lift.code, lift.message, where="lift_tool"))
            handle.abort()
        return result

    async def _move_aside(self, handle: ServerGoalHandle) -> MoveAside.Result:
        try:
            controller = self._armed("move_aside")
            with self._lock:
                controller.move_aside()
                self._begun()
        except IsfError as error:
            self._node.report(error)
            handle.abort()
            return MoveAside.Result(code=int(error.code), message=error.message)

        def notify() -> None:
            handle.publish_feedback(MoveAside.Feedback(tip_1=list(controller.targets.tip_1)))

        def cancel() -> None:
            controller.stop("move_aside was cancelled")

        await in_thread(
            lambda: follow(handle, lambda: self._moving(controller), cancel, self._lock, notify), self._node.executor
        )
        if controller.fault is None:
            handle.succeed()
            return MoveAside.Result()
        code, message = controller.fault
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            self._node.report(IsfError(code, message, where="move_aside"))
            handle.abort()
        return MoveAside.Result(code=int(code), message=message)

    def _armed(self, action: str) -> ForceController:
        controller = self._controller()
        if controller is None:
            raise IsfError(ErrorCode.NOT_ARMED, "no plan is armed", where=action, advice="arm the plan first")
        return controller


def follow(
    handle: ServerGoalHandle,
    busy: Callable[[], bool],
    cancel: Callable[[], None],
    lock: threading.RLock,
    notify: Callable[[], None],
) -> None:
    """As long as ``busy``; ticks go on in the node's own callbacks meanwhile. ``notify`` gives feedback."""
    cancelled = False
    while busy():
        if handle.is_cancel_requested and not cancelled:
            cancelled = True
            with lock:
                cancel()
        notify()
        time.sleep(PERIOD)  # between two messages of feedback; the measurement ends by its ticks, not by this
