"""What the machine publishes: wrenches every tick; poses, state and clock decimated."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_core.height_map import HeightMap
from isf_msgs.msg import MachineState
from isf_node import conversion, qos, stamps
from isf_node.lifecycle import CellNode
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2

from isf_sim.machine import MachineSample

SCAN_PATIENCE = 5.0
"""s of wall time for the subscribers of a scan to take it."""


class MachineOutlet:
    """The node's publishers and their messages, which are filled anew for every tick."""

    def __init__(self, node: CellNode[Any], *, clock: bool) -> None:
        self._node = node
        self._wrenches = [self._publisher(WrenchStamped, f"tool_{k}/wrench", qos.STREAM_SOURCE) for k in (1, 2)]
        self._poses = [self._publisher(PoseStamped, f"tool_{k}/pose", qos.SENSOR) for k in (1, 2)]
        self._state = self._publisher(MachineState, "machine/state", qos.STREAM_SOURCE)
        self._scan = self._publisher(PointCloud2, "scan", qos.LATCHED)
        self._clock = self._publisher(Clock, "/clock", qos.SENSOR) if clock else None
        self._wrench_messages = [conversion.make_wrench() for _ in (1, 2)]
        self._pose_messages = [conversion.make_pose() for _ in (1, 2)]

    def close(self) -> None:
        """Destroy the publishers."""
        publishers = [*self._wrenches, *self._poses, self._state, self._scan]
        for publisher in [*publishers, self._clock] if self._clock else publishers:
            self._node.destroy_publisher(publisher)

    def wrenches(self, sample: MachineSample, nanoseconds: int) -> None:
        """Both wrenches with the stamp ``nanoseconds``."""
        stamp = stamps.to_stamp(nanoseconds)
        readings = (sample.wrench_1, sample.wrench_2)
        for publisher, message, reading in zip(self._wrenches, self._wrench_messages, readings, strict=True):
            message.header.stamp = stamp
            conversion.set_wrench(message, reading)
            publisher.publish(message)

    def poses(self, sample: MachineSample, nanoseconds: int) -> None:
        """Both tips by the encoders, and the clock in lockstep."""
        stamp = stamps.to_stamp(nanoseconds)
        for publisher, message, tip in zip(self._poses, self._pose_messages, (sample.tip_1, sample.tip_2), strict=True):
            message.header.stamp = stamp
            conversion.set_tip(message, tip)
            publisher.publish(message)
        if self._clock is not None:
            self._clock.publish(Clock(clock=stamp))

    def state(self, message: MachineState, nanoseconds: int) -> None:
        """The machine's state."""
        message.header.frame_id = conversion.FRAME
        message.header.stamp = stamps.to_stamp(nanoseconds)
        self._state.publish(message)

    def scan(self, shape: HeightMap, nanoseconds: int) -> None:
        """A measured shape; returns when every reliable subscriber has it, so that the cell may be ended then."""
        self._scan.publish(conversion.height_map_to_message(shape, stamps.to_stamp(nanoseconds)))
        self._scan.wait_for_all_acked(Duration(seconds=SCAN_PATIENCE))

    def _publisher(self, kind: Any, topic: str, profile: Any) -> Publisher[Any]:
        return self._node.create_publisher(kind, topic, profile)
