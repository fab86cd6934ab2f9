"""What force_ctrl publishes: targets (poses or twists) every tick, the blank holder, states and results.

Targets as twists are for drivers that follow a velocity: what the trajectory does, and a pull back onto it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped
from isf_core.contour import ContourResult
from isf_core.files.job import JobFile
from isf_core.geometry.tool_axis import UPRIGHT
from isf_msgs import msg as isf
from isf_msgs.srv import Arm
from isf_ros import conversion, qos, stamps
from isf_ros.lifecycle import CellNode
from rclpy.publisher import Publisher

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import ControlState, Targets, Vector
from isf_force_ctrl.ros.joint_targets import JointTargets

RESTING = 10
"""Twists of zero that are sent when the tools are to stand."""


class ForceCtrlPublishers:
    """The node's publishers and the messages of its streams, which are filled anew for every tick.

    ``twist``: targets go out as TwistStamped on ``tool_k/target_twist`` instead of poses on ``tool_k/target``.
    ``joints``: they go out as joint positions too, by the names of the description when ``described``.
    """

    def __init__(
        self, node: CellNode[Any], *, twist: bool = False, joints: bool = False, described: bool = False
    ) -> None:
        self._node = node
        self._joints = JointTargets(node, described=described) if joints else None
        kind, topic = (TwistStamped, "target_twist") if twist else (PoseStamped, "target")
        self._targets = [self._publisher(kind, f"tool_{k}/{topic}", qos.STREAM_SOURCE) for k in (1, 2)]
        self._twists: list[TargetTwist] | None = None
        self._twist_messages = (TwistStamped(), TwistStamped()) if twist else None
        for message in self._twist_messages or ():
            message.header.frame_id = conversion.FRAME
        self._zeros = 0
        self._holder = self._publisher(PoseStamped, "holder/target", qos.STREAM_SOURCE)
        self._states = self._publisher(isf.ForceCtrlState, "force_ctrl/state", qos.STREAM_SOURCE)
        self._results = self._publisher(isf.ContourResult, "contour/result", qos.EVENT)
        self._armed = self._publisher(isf.ForceCtrlArmed, "force_ctrl/armed", qos.LATCHED)
        self._messages = (conversion.make_pose(), conversion.make_pose())
        self._axis: Vector = UPRIGHT
        self._holder_message = conversion.make_pose()
        self.with_holder = False
        """The machine has a blank holder that moves: its target goes out with every pair of targets."""
        self.has_targets = False
        self.last_publish = 0.0
        """s, monotonic time of the last targets."""

    def armed(self, request: Arm.Request, tip_1: Vector, tip_2: Vector, axis: Vector, config: ControlConfig) -> None:
        """What was armed, with the tools at ``tip_1``, ``tip_2`` m, tool 1 with its ``axis``: to replay a bag with."""
        message = isf.ForceCtrlArmed(plan_id=request.plan_id, first_index=request.first_index, count=request.count)
        message.header.frame_id = conversion.FRAME
        message.header.stamp = self._node.get_clock().now().to_msg()
        for point, tip in ((message.tip_1, tip_1), (message.tip_2, tip_2)):
            point.x, point.y, point.z = tip
        message.axis.x, message.axis.y, message.axis.z = axis
        asked = conversion.set_point_of(request.support_force)
        message.support_force = math.nan if asked is None else asked
        message.settings = config.to_json()
        self._armed.publish(message)

    def aim(self, job_file: JobFile, rate: float) -> None:
        """Targets of the part of ``job_file`` follow."""
        if self._joints is not None:
            self._joints.start(job_file, rate)

    def unheard(self, tools: Sequence[int]) -> list[str]:
        """Topics of joints of ``tools`` (1, 2) that nobody has subscribed to yet; none where joints are not sent."""
        return [] if self._joints is None else self._joints.unheard(tools)

    def start(self, tip_1: Vector, tip_2: Vector, rate: float, axis: Vector = UPRIGHT) -> None:
        """Targets follow, ``rate`` per second; the tools are at ``tip_1``, ``tip_2`` m, tool 1 with its ``axis``."""
        self.has_targets = False
        self._twists = [TargetTwist(tip_1, rate, axis), TargetTwist(tip_2, rate)]

    def measured(self, tool: int, tip: Vector) -> None:
        """The tip (3,) m of ``tool`` (1, 2) that the machine reported."""
        if self._twists is not None:
            self._twists[tool - 1].measured = tip

    def rest(self, *, last: bool = False) -> None:
        """The tools are to stand: a driver that follows twists must be told. ``last``: nothing is sent after this."""
        while self._twist_messages is not None and self._zeros > 0:
            self._zeros -= 1
            self._send_twists(((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), None)
            if not last:
                break

    def targets(self, targets: Targets, stamp: int) -> None:
        """Both targets, valid at ``stamp`` ns."""
        seconds, rest = divmod(stamp, stamps.NANO)
        if self._twist_messages is not None and self._twists is not None:
            self._zeros = RESTING
            velocities = [law.step(tip) for law, tip in zip(self._twists, targets[:2], strict=True)]
            turning = self._twists[0].turn(targets.axis)
            self._send_twists(velocities, (seconds, rest), turning)
        else:
            if targets.axis != self._axis:
                self._axis = targets.axis
                conversion.set_axis(self._messages[0], targets.axis)
            for message, tip, publisher in zip(self._messages, targets[:2], self._targets, strict=True):
                message.header.stamp.sec, message.header.stamp.nanosec = seconds, rest
                position = message.pose.position
                position.x, position.y, position.z = tip
                publisher.publish(message)
        if self._joints is not None:
            self._joints.send(targets)
        if self.with_holder:
            holder = self._holder_message
            holder.header.stamp.sec, holder.header.stamp.nanosec = seconds, rest
            holder.pose.position.z = targets.holder_height
            self._holder.publish(holder)
        self.has_targets = True
        self.last_publish = time.monotonic()

    def repeat(self, stamp: int | None = None) -> None:
        """The last targets once more: a sign of life; with their own stamp, or with ``stamp`` ns.

        Only while the tools rest: as twists these are none.
        """
        if self._twist_messages is not None:
            self._send_twists(((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), None if stamp is None else divmod(stamp, stamps.NANO))
            return
        for message, publisher in zip(self._messages, self._targets, strict=True):
            if stamp is not None:
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, stamps.NANO)
            publisher.publish(message)
        if self._joints is not None:
            self._joints.repeat()
        if self.with_holder:
            self._holder.publish(self._holder_message)
        self.last_publish = time.monotonic()

    def _send_twists(
        self, velocities: Sequence[Vector], stamp: tuple[int, int] | None, turning: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        if self._twist_messages is not None:
            angular = self._twist_messages[0].twist.angular
            angular.x, angular.y, angular.z = turning
        for message, velocity, publisher in zip(self._twist_messages or (), velocities, self._targets, strict=True):
            if stamp is not None:
                message.header.stamp.sec, message.header.stamp.nanosec = stamp
            linear = message.twist.linear
            linear.x, linear.y, linear.z = velocity
            publisher.publish(message)

    def state(self, state: ControlState, stamp: int, latency: float) -> None:
        """The controller's state at ``stamp`` ns; ``latency`` s from wrench to targets."""
        message = isf.ForceCtrlState()
        message.header.frame_id = conversion.FRAME
        message.header.stamp = stamps.to_stamp(stamp)
        message.latency = latency
        for item in fields(state):
            value = getattr(state, item.name)
            if item.name in ("forming_offset", "support_offset"):
                vector = getattr(message, item.name)
                vector.x, vector.y, vector.z = value
            else:
                setattr(message, item.name, int(value) if item.name == "mode" else value)
        self._states.publish(message)

    def result(self, result: ContourResult) -> None:
        """What happened to a contour."""
        self._results.publish(conversion.result_to_message(result, self._node.get_clock().now().to_msg()))

    def refusal(self, contour: isf.Contour, code: int, text: str) -> None:
        """A result that says why a contour was refused, so that nobody waits for it."""
        result = isf.ContourResult(plan_id=contour.plan_id, index=contour.index, code=code)
        result.message = text
        result.header.frame_id = conversion.FRAME
        result.header.stamp = self._node.get_clock().now().to_msg()
        self._results.publish(result)

    def _publisher(self, kind: Any, topic: str, profile: Any) -> Publisher[Any]:
        return self._node.create_publisher(kind, topic, profile)


PULL = 5.0
"""1/s. Assumed: slow against a servo of 30 Hz, so that its lag is no oscillation, and fast against drift."""

MAXIMUM_PULL = 0.01
"""m/s, most that the pull adds."""


class TargetTwist:
    """Velocity (3,) m/s of one tool from its targets (3,) m, one per period of 1 / ``rate`` s, and its measured tip."""

    def __init__(self, start: Vector, rate: float, axis: Vector = UPRIGHT) -> None:
        """``start``: where the tool is, m ; ``axis``: (3,) unit, how it stands."""
        self._last, self._rate = start, rate
        self._axis = axis
        self.measured: Sequence[float] = start
        """(3,) m, newest measured tip."""

    def turn(self, axis: Vector) -> Vector:
        """Angular velocity rad/s that brings the tool's axis to ``axis`` (3,) in this period; nothing pulls it back."""
        if axis == self._axis:
            return (0.0, 0.0, 0.0)
        (a, b, c), (x, y, z), rate = self._axis, axis, self._rate
        self._axis = axis
        return (rate * (b * z - c * y), rate * (c * x - a * z), rate * (a * y - b * x))

    def step(self, target: Vector) -> Vector:
        """Velocity to be at ``target`` at the end of this period."""
        last, measured, rate = self._last, self.measured, self._rate
        x, y, z = (PULL * (last[k] - measured[k]) for k in range(3))
        size = math.sqrt(x * x + y * y + z * z)
        share = MAXIMUM_PULL / size if size > MAXIMUM_PULL else 1.0
        self._last = target
        return (
            rate * (target[0] - last[0]) + share * x,
            rate * (target[1] - last[1]) + share * y,
            rate * (target[2] - last[2]) + share * z,
        )
