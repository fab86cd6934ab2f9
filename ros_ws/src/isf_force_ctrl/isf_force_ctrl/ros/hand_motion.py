"""Movement by hand in node ``force_ctrl``: action ``move_to``, topics ``jog`` and ``joy``, state ``force_ctrl/hand``.

Targets come from the one controller of the node, as those of a contour do: whoever moves a tool, there is one stream.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_msgs.action import MoveTo
from isf_msgs.msg import HandState, Jog
from isf_ros import qos
from isf_ros.background import in_thread
from isf_ros.lifecycle import CellNode
from isf_ros.watchdog import RegularLook
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import Joy

from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.hand.hand_move import LARGEST_JOG, SPEED, HandMove
from isf_force_ctrl.hand.hand_space import HandSpace
from isf_force_ctrl.hand.jog_desk import SILENCE, JogDemand, JogDesk, Wish
from isf_force_ctrl.hand.joy_map import JoyKeys, JoyMap
from isf_force_ctrl.measurements.measurement import AtRest
from isf_force_ctrl.motion.segments import Column
from isf_force_ctrl.ros.measurement_actions import follow
from isf_force_ctrl.ros.parameters import ForceCtrlParameters
from isf_force_ctrl.ros.readiness import Readiness

STATE_PERIOD = 0.1
"""s of wall time between two messages of the state while nothing changes."""

ACTION = "move_to"
"""Name of the action, and of a client that gives none."""

LEAST_STEP = 1e-6
"""m, shorter ways are none."""


class HandMotion:
    """Serves ``node``; moves nothing unless it is armed by hand.

    ``controller`` gives the present one (None: nothing was armed), ``begun`` is called with the lock held when a
    movement begins, so that the first targets go out, and ``moving`` is true until a movement has ended.
    """

    def __init__(
        self,
        node: CellNode[ForceCtrlParameters],
        lock: threading.RLock,
        ready: Readiness,
        controller: Callable[[], ForceController | None],
        begun: Callable[[], None],
        moving: Callable[[ForceController], bool],
    ) -> None:
        """Raises IsfError FILE_FIELD of the parameters of ``joy``."""
        self._node, self._lock, self._ready = node, lock, ready
        self._controller, self._begun, self._moving = controller, begun, moving
        self._desk = JogDesk()
        self._look = RegularLook(0.5 * SILENCE)
        self._space: HandSpace | None = None
        self._move: HandMove | None = None
        self._has_goal = False  # what moves is to get to a place
        self._tool, self._told = 1, (ErrorCode.OK, "")
        self._sent, self._last = 0.0, HandState()
        p = node.values()
        self._joy = JoyMap(JoyKeys.of(p.joy_axes, p.joy_enable, p.joy_tool, p.joy_smaller, p.joy_larger))
        self._state = node.create_publisher(HandState, "force_ctrl/hand", qos.CHANGES)
        node.create_subscription(Jog, "jog", self._on_jog, qos.STREAM)
        node.create_subscription(Joy, "joy", self._on_joy, qos.STREAM)
        node.create_action_server(MoveTo, ACTION, self._move_to, lambda _: True)  # who is not armed says so

    @property
    def armed(self) -> bool:
        """True while tools are moved by hand, and no contour is taken."""
        return self._space is not None

    def arm(self, space: HandSpace) -> None:
        """The tools may be moved in ``space``."""
        self._space, self._move, self._told = space, None, (ErrorCode.OK, "")
        self._desk.release()
        self._publish()

    def disarm(self) -> None:
        """No tool is moved by hand any more."""
        if self._space is not None:
            self._space, self._move = None, None
            self._desk.release()
            self._publish()

    def watch(self) -> None:
        """To be called often, with the lock held: a client that is not heard any more has let go of its button."""
        late = self._look.late()
        if self._space is None:
            return
        if late:
            self._desk.not_served()
        if self._desk.lost():
            self._leave_alone(self._desk.owner)
            self._desk.release(lost=True)
        self._settle()
        self._publish()

    def _leave_alone(self, owner: str) -> None:
        """The client ``owner`` was lost: what it moves is brought to a stand."""
        if self._move is not None and not self._move.ended:
            text = f"nothing on jog from '{owner}' for {SILENCE:g} s: the tool stands (press its key again)"
            self._move.give_up(ErrorCode.HAND_LOST, text, stay=True)

    def _settle(self) -> None:
        """Forget a movement that has ended, as soon as anybody asks: its client may come with the next at once."""
        move = self._move
        if move is None or not move.ended:
            return
        self._move = None
        self._told = (move.code, move.message)
        if move.code is not ErrorCode.OK:
            self._node.get_logger().warning(f"[{move.code} {move.code.name}] {move.message}")

    # -- messages --------------------------------------------------------------------------------

    def _on_jog(self, message: Jog) -> None:
        way = message.direction
        self._hear(
            JogDemand(
                message.client or "jog",
                message.enable,
                message.tool,
                (way.x, way.y, way.z),
                message.increment,
                message.speed,
            )
        )

    def _on_joy(self, message: Joy) -> None:
        self._hear(self._joy.demand(message.axes, message.buttons))

    def _hear(self, demand: JogDemand) -> None:
        with self._lock:
            if self._space is None:
                return
            before = self._desk.owner
            wish = self._desk.hear(demand)
            if before and self._desk.owner == demand.client != before:  # lost, and the next one was heard before watch
                self._leave_alone(before)
            if self._move is None and self._desk.owner == demand.client != before:
                self._told = (ErrorCode.OK, "")  # what another one was refused, or this one before, is over
            try:
                if wish is Wish.TAKEN:
                    raise self._taken(demand.client)
                if wish is Wish.LET_GO:
                    raise IsfError(
                        ErrorCode.HAND_LOST,
                        f"nothing on jog from '{demand.client}' for {SILENCE:g} s while it pressed its key",
                        where="jog",
                        advice="let go of it, and press it again",
                    )
                if wish is Wish.STOP and self._move is not None:
                    self._stop_move(self._move, demand.client)
                if wish is Wish.START and self._move is None:
                    self._desk.begun()
                    self._jog(demand)
            except IsfError as error:
                self._refuse(error)

    def _stop_move(self, move: HandMove, client: str) -> None:
        """The button was let go: the end of a jog, and of a movement to a place why it does not get there."""
        if self._has_goal:
            move.give_up(ErrorCode.STOPPED, f"'{client}' let go of its button before the tool was there", stay=True)
        else:
            move.stop()

    def _jog(self, demand: JogDemand) -> None:
        """Begin the step, or the movement, that ``demand`` asks for; raises IsfError why not."""
        direction, speed = np.array(demand.key), min(demand.speed if demand.speed > 0.0 else SPEED, LARGEST_JOG)
        if not (demand.increment >= 0.0 and np.isfinite(speed)):
            raise IsfError(ErrorCode.MOVE_OUT_OF_REACH, "increment or speed is no number", where="jog")

        def way(space: HandSpace, start: Array, other: Array) -> Array:
            if demand.increment > 0.0:
                space.check(demand.tool, start, start + demand.increment * direction, other, to_sheet=True)
                return demand.increment * direction
            room = space.room(demand.tool, start, direction, other)
            if room <= LEAST_STEP:  # say why
                space.check(demand.tool, start, start + 1e-3 * direction, other, to_sheet=True)
            return room * direction

        self._start(demand.tool, way, speed, demand.client)

    def _start(
        self, tool: int, way_of: Callable[[HandSpace, Array, Array], Array], speed: float, client: str
    ) -> HandMove:
        """Begin a movement along ``way_of`` space, tip and the other tip, (3,) m; raises IsfError why not."""
        controller, space = self._armed()
        space.check_tool(tool)
        if tool not in self._ready.needed:
            raise IsfError(
                ErrorCode.WRENCH_LOST,
                f"nobody tells the force on tool_{tool}, which would not be stopped by what it touches",
                where="tool",
                advice="the job's process has to use the load cell of this tool",
            )
        self._ready.check(tared=self._node.values().wrenches_tared)

        def make(rest: AtRest) -> HandMove:
            tips = [np.array(rest.row[k : k + 3]) for k in (Column.TIP_1, Column.TIP_2)]
            way = way_of(space, tips[tool - 1], tips[2 - tool])
            force, floors = self._node.values().hand_force, (space.floor(1), space.floor(2))
            return HandMove(rest, tool, way, speed, touch_force=force, floors=floors, client=client)

        self._move, self._has_goal = controller.measure(make), False
        self._tool, self._told = tool, (ErrorCode.OK, "")
        self._publish()  # first: a short step may have ended before anybody looks
        self._begun()
        return self._move

    def _armed(self) -> tuple[ForceController, HandSpace]:
        controller, space = self._controller(), self._space
        if controller is None or space is None:
            raise IsfError(
                ErrorCode.NOT_ARMED,
                "force_ctrl is not armed by hand",
                where=ACTION,
                advice="set the executive to manual (isf mode manual)",
            )
        if controller.fault is not None and controller.fault[0] is not ErrorCode.STOPPED:
            raise IsfError(
                controller.fault[0],
                controller.fault[1],
                where="force_ctrl holds",
                advice="when the cause is gone, set the mode manual again",
            )
        return controller, space

    # -- action ----------------------------------------------------------------------------------

    async def _move_to(self, handle: ServerGoalHandle) -> MoveTo.Result:
        goal = handle.request
        client = goal.client or ACTION
        try:
            with self._lock:
                controller, _ = self._armed()
                self._settle()
                if self._move is not None or not self._desk.take(client, watched=bool(goal.client)):
                    raise self._taken(client)
                try:
                    move = self._start(goal.tool, self._way_to(goal), goal.speed, client)
                    self._has_goal = True
                except IsfError:
                    self._desk.release()
                    raise
        except IsfError as error:
            self._refuse(error)
            handle.abort()
            return MoveTo.Result(code=int(error.code), message=error.message)

        def notify() -> None:
            handle.publish_feedback(MoveTo.Feedback(position=_point(move.tip), left=move.left, force=move.force))

        def cancel() -> None:
            move.give_up(ErrorCode.STOPPED, "move_to was cancelled", stay=True)

        def busy() -> bool:
            return self._moving(controller) and not (move.ended and not controller.busy)

        await in_thread(lambda: follow(handle, busy, cancel, self._lock, notify), self._node.executor)
        with self._lock:
            if self._desk.owner == client:
                self._desk.release()
            if not move.ended and move.code is ErrorCode.OK:
                move.give_up(ErrorCode.STOPPED, "the movement was ended from outside", stay=True)
            self._settle()
            self._publish()  # before the result: who hears of its end may ask at once for what takes a standing tool
        if move.code is ErrorCode.OK:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return MoveTo.Result(code=int(move.code), message=move.message, position=_point(move.tip))

    def _way_to(self, goal: MoveTo.Goal) -> Callable[[HandSpace, Array, Array], Array]:
        end = np.array([goal.position.x, goal.position.y, goal.position.z])
        if not goal.speed >= 0.0:
            raise IsfError(ErrorCode.MOVE_OUT_OF_REACH, f"speed of {goal.speed} m/s", where=ACTION, advice="0 or more")

        def way(space: HandSpace, start: Array, other: Array) -> Array:
            space.check(goal.tool, start, end, other, to_sheet=False)
            return np.asarray(end - start)

        return way

    def _taken(self, client: str) -> IsfError:
        return IsfError(
            ErrorCode.HAND_TAKEN,
            f"'{self._desk.owner}' moves a tool, '{client}' has to wait",
            where="force_ctrl",
            advice="one client at a time: let go of the other one's button",
        )

    # -- state -----------------------------------------------------------------------------------

    def _refuse(self, error: IsfError) -> None:
        """What was not done: told in the state; nothing is at fault in the cell."""
        if self._told != (error.code, error.message):
            self._node.get_logger().warning(str(error))
        self._told = (error.code, error.message)
        self._publish()

    def _publish(self) -> None:
        """At every change, and now and then."""
        controller, move = self._controller(), self._move
        state = HandState(
            armed=self.armed,
            moving=move is not None and not move.ended,
            tool=self._tool,
            client=self._desk.owner,
            code=int(self._told[0]),
            message=self._told[1],
        )
        if controller is not None:
            state.tip_1, state.tip_2 = _point(controller.targets.tip_1), _point(controller.targets.tip_2)
        now, last = time.monotonic(), self._last
        news = [(one.armed, one.moving, one.client, one.code, one.message) for one in (state, last)]
        if news[0] == news[1] and now - self._sent < STATE_PERIOD:
            return
        self._sent, self._last = now, state
        state.header.frame_id = "sheet"
        state.header.stamp = self._node.get_clock().now().to_msg()
        self._state.publish(state)


def _point(tip: Any) -> Point:
    x, y, z = tip
    return Point(x=float(x), y=float(y), z=float(z))
