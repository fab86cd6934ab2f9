"""Targets as joint positions, for a joint_trajectory_controller per tool: one point per tick.

A trajectory of one point, one period ahead, replaces the one before it; its stamp is zero, which means now. A
controller does not know where the trajectory began that it hears first: it has to hear where the tools stand before
they move.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.tool_axis import UPRIGHT
from isf_core.geometry.tool_joints import ToolJoints
from isf_core.types import Array
from isf_ros import qos
from isf_ros.lifecycle import CellNode
from rclpy.publisher import Publisher
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from isf_force_ctrl.control_state import Targets, Vector


class JointTargets:
    """Publishers of ``tool_k/joint_trajectory``; joints have the names of the cell's description when ``described``, or
    else those of the rig file where it has any, as of an arm."""

    def __init__(self, node: CellNode[Any], *, described: bool) -> None:
        self._described = described
        self._publishers: list[Publisher] = [
            node.create_publisher(JointTrajectory, f"tool_{k}/joint_trajectory", qos.STREAM_SOURCE) for k in (1, 2)
        ]
        self._joints: list[ToolJoints] = []
        self._messages = [JointTrajectory(), JointTrajectory()]
        self._last: list[Array | None] = [None, None]
        self._rate = 1.0

    def start(self, job_file: JobFile, rate: float) -> None:
        """Targets of a part follow, ``rate`` per second."""
        specs = (job_file.job.tool_1, job_file.job.tool_2)
        self._joints = [
            ToolJoints.of(job_file.rig, k, 0.0 if spec is None else spec.ball_radius)
            for k, spec in enumerate(specs, start=1)
        ]
        self._rate, self._last = rate, [None, None]
        for k, (joints, message) in enumerate(zip(self._joints, self._messages, strict=True), start=1):
            point = JointTrajectoryPoint()
            point.time_from_start.nanosec = round(1e9 / rate)
            in_rig = not self._described and job_file.rig.arm(k) is not None
            message.joint_names = list(joints.kinematics.axes if in_rig else joints.names)
            message.points = [point]

    def unheard(self, tools: Sequence[int]) -> list[str]:
        """Topics of ``tools`` (1, 2) that nobody has subscribed to yet."""
        return [f"tool_{k}/joint_trajectory" for k in tools if not self._publishers[k - 1].get_subscription_count()]

    def send(self, targets: Targets) -> None:
        """Joints for both targets; those of a tip out of reach are left out, which the machine reports."""
        for k, (joints, tip) in enumerate(zip(self._joints, targets[:2], strict=True)):
            self._send(k, joints, tip, targets.axis if k == 0 else UPRIGHT)

    def repeat(self) -> None:
        """The last joints once more, at rest."""
        for k, positions in enumerate(self._last):
            if positions is not None:
                self._messages[k].points[0].velocities = [0.0] * len(positions)
                self._publishers[k].publish(self._messages[k])

    def _send(self, k: int, joints: ToolJoints, tip: Vector, axis: Vector) -> None:
        try:
            positions = joints.positions(tip, axis)
        except IsfError:
            return
        last, self._last[k] = self._last[k], positions
        point = self._messages[k].points[0]
        point.positions = positions.tolist()
        point.velocities = (self._rate * (positions - (positions if last is None else last))).tolist()
        self._publishers[k].publish(self._messages[k])
