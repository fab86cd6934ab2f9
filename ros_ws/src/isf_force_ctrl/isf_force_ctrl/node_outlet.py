"""What force_ctrl publishes: targets every tick, the blank holder where there is one, states and results."""

from __future__ import annotations

import time
from dataclasses import fields
from typing import Any

from geometry_msgs.msg import PoseStamped
from isf_core.contour import ContourResult
from isf_msgs import msg as isf
from isf_node import conversion, qos, stamps
from isf_node.lifecycle import CellNode
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.publisher import Publisher

from isf_force_ctrl.control_state import ControlState, Targets


class ForceCtrlOutlet:
    """The node's publishers and the messages of its streams, which are filled anew for every tick."""

    def __init__(self, node: CellNode[Any]) -> None:
        self._node = node
        self._targets = [self._publisher(PoseStamped, f"tool_{k}/target", qos.STREAM_SOURCE) for k in (1, 2)]
        self._holder = self._publisher(PoseStamped, "holder/target", qos.STREAM_SOURCE)
        self._states = self._publisher(isf.ForceCtrlState, "force_ctrl/state", qos.STREAM_SOURCE)
        self._results = self._publisher(isf.ContourResult, "contour/result", qos.EVENT)
        self._messages = (conversion.make_pose(), conversion.make_pose())
        self._holder_message = conversion.make_pose()
        self.with_holder = False
        """The machine has a blank holder that moves: its target goes out with every pair of targets."""
        self.has_targets = False
        self.last_publish = 0.0
        """s, monotonic time of the last targets."""

    def close(self) -> None:
        """Destroy the publishers."""
        for publisher in (*self._targets, self._holder, self._states, self._results):
            self._node.destroy_publisher(publisher)

    def targets(self, targets: Targets, stamp: int) -> None:
        """Both targets, valid at ``stamp`` ns."""
        seconds, rest = divmod(stamp, stamps.NANO)
        for message, tip, publisher in zip(self._messages, targets[:2], self._targets, strict=True):
            message.header.stamp.sec, message.header.stamp.nanosec = seconds, rest
            position = message.pose.position
            position.x, position.y, position.z = tip
            publisher.publish(message)
        if self.with_holder:
            holder = self._holder_message
            holder.header.stamp.sec, holder.header.stamp.nanosec = seconds, rest
            holder.pose.position.z = targets.holder_height
            self._holder.publish(holder)
        self.has_targets = True
        self.last_publish = time.monotonic()

    def repeat(self, stamp: int | None = None) -> None:
        """The last targets once more: a sign of life; with their own stamp, or with ``stamp`` ns."""
        for message, publisher in zip(self._messages, self._targets, strict=True):
            if stamp is not None:
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, stamps.NANO)
            publisher.publish(message)
        if self.with_holder:
            self._holder.publish(self._holder_message)
        self.last_publish = time.monotonic()

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
        # Each event handler is one more entity in every wait of the executor: a third of the time of a tick.
        callbacks = PublisherEventCallbacks(use_default_callbacks=False)
        return self._node.create_publisher(kind, topic, profile, event_callbacks=callbacks)
