"""Targets of tools on arms as joint positions, for a joint_trajectory_controller: one point per tick.

A trajectory of one point, one period ahead, replaces the one before it; its stamp is zero, which means now. Joints have
the names of the rig file.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.serial_arm import SerialArm
from isf_core.geometry.tool_axis import UPRIGHT, point_on_axis, tilt_of
from isf_core.types import Array
from isf_ros import qos
from isf_ros.lifecycle import CellNode
from rclpy.publisher import Publisher
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from isf_force_ctrl.control_state import Targets, Vector


class JointTargets:
    """Publishers of ``tool_k/joint_trajectory`` for the tools that arms carry."""

    def __init__(self, node: CellNode[Any]) -> None:
        self._publishers: list[Publisher] = [
            node.create_publisher(JointTrajectory, f"tool_{k}/joint_trajectory", qos.STREAM_SOURCE) for k in (1, 2)
        ]
        self._arms: list[SerialArm | None] = [None, None]
        self._messages = [JointTrajectory(), JointTrajectory()]
        self._last: list[Array | None] = [None, None]
        self._rate, self._ball = 1.0, 0.0

    def start(self, job_file: JobFile, rate: float) -> None:
        """Targets of a part follow, ``rate`` per second.

        Raises
        ------
        IsfError : FILE_FIELD when the rig has no arm
        """
        arms = [job_file.rig.arm(1), job_file.rig.arm(2)]
        if arms == [None, None]:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"the rig {job_file.rig.name} has no arm whose joints could be told",
                where="output",
                advice="output: pose, or a rig with kinematics: arm",
            )
        self._arms, self._rate, self._ball = arms, rate, job_file.job.tool_1.ball_radius
        self._last = [None, None]
        for arm, message in zip(arms, self._messages, strict=True):
            if arm is not None:
                point = JointTrajectoryPoint()
                point.time_from_start.nanosec = round(1e9 / rate)
                message.joint_names, message.points = list(arm.axes), [point]

    def send(self, targets: Targets) -> None:
        """Joints for both targets; those of a tip out of reach are left out, which the machine reports."""
        for k, (arm, tip) in enumerate(zip(self._arms, targets[:2], strict=True)):
            if arm is not None:
                self._send(k, arm, tip, targets.axis if k == 0 else UPRIGHT)

    def repeat(self) -> None:
        """The last joints once more, at rest."""
        for k, joints in enumerate(self._last):
            if joints is not None:
                self._messages[k].points[0].velocities = [0.0] * len(joints)
                self._publishers[k].publish(self._messages[k])

    def _send(self, k: int, arm: SerialArm, tip: Vector, axis: Vector) -> None:
        place, tilt = np.array(tip), np.zeros(2)
        if axis != UPRIGHT:
            leaning = np.array(axis)
            place, tilt = point_on_axis(place, leaning, self._ball), tilt_of(leaning)
        joints, margin, _ = arm.held(place, tilt)
        if not np.isfinite(margin):
            return
        last, self._last[k] = self._last[k], joints
        point = self._messages[k].points[0]
        point.positions = joints.tolist()
        point.velocities = (self._rate * (joints - (joints if last is None else last))).tolist()
        self._publishers[k].publish(self._messages[k])
