"""The machine's axes as joints: commanded and told by JointState, as a hardware component of ros2_control speaks.

Commands of both tools come in one message, states go out with every tick. A component sends what its controllers last
commanded, from its own start on and whether anybody moves anything: commands are followed from the first one on that is
where the tools are, so a controller that holds another place moves nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.tool_axis import UPRIGHT
from isf_core.geometry.tool_joints import ToolJoints, Vector
from isf_core.types import Array
from isf_ros import qos, stamps
from isf_ros.lifecycle import CellNode
from sensor_msgs.msg import JointState

from isf_sim.machine.simulated_machine import MachineSample

COMMANDS, STATES = "machine/joint_commands", "machine/joint_states"

CAUGHT_UP = 0.1
"""s of motion that may come in one command. A controller passes on the newest of the trajectories that have come: where
their sender was late, its axes make up for that in one step. force_ctrl leaves out what is older than this."""

MOVES = 1e-6
"""m between two commands of axes that move."""

NEAR = 1e-3
"""m between the tips commanded and those measured, up to which commands that are not followed yet begin to be."""


@dataclass(frozen=True)
class Command:
    """Where both tools are to be: tips (3,) m, axis (3,) of tool 1, at ``stamp`` ns."""

    stamp: int
    tips: tuple[Vector, Vector]
    axis: Vector


class JointInterface:
    """Topics of ``node``; ``take`` is called with every command of the machine that is clamped at the time."""

    def __init__(self, node: CellNode[Any], take: Callable[[Command], None]) -> None:
        self._node, self._take = node, take
        self._joints: tuple[ToolJoints, ToolJoints] | None = None
        self._parked: tuple[Vector, Vector] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        self._last: Array | None = None
        self._last_tick = 0
        self._rate, self._told = 1.0, ""
        self._stray: Command | None = None
        self._state = JointState()
        self._states = node.create_publisher(JointState, STATES, qos.STREAM)
        node.create_subscription(JointState, COMMANDS, self._on_command, qos.STREAM)

    def clamp(self, job_file: JobFile) -> None:
        """The machine of ``job_file`` is there from now on, parked."""
        job, rig = job_file.job, job_file.rig
        balls = (job.tool_1.ball_radius, job.tool_2.ball_radius if job.tool_2 is not None else 0.0)
        self._joints = (ToolJoints.of(rig, 1, balls[0]), ToolJoints.of(rig, 2, balls[1]))
        self._parked = ((0.0, 0.0, rig.park_height), (0.0, 0.0, -rig.park_height))
        self._rate, self._last, self._stray = job.control.rate, None, None
        self._state.name = [name for joints in self._joints for name in joints.names]

    def strays(self, command: Command) -> bool:
        """True of a command that is not followed and moves on from the one before: somebody believes the tools go."""
        last, self._stray = self._stray, command
        if last is None or not all(math.isfinite(value) for tip in (*last.tips, *command.tips) for value in tip):
            return False
        return max(math.dist(a, b) for a, b in zip(last.tips, command.tips, strict=True)) > MOVES

    def publish(self, sample: MachineSample, nanoseconds: int) -> None:
        """Positions and velocities of all joints, by the encoders."""
        if self._joints is None:
            return
        upper, lower = self._joints
        positions = np.concatenate([upper.positions(sample.tip_1, sample.axis_1), lower.positions(sample.tip_2)])
        ticks = max(1, sample.tick - self._last_tick)  # more than one after a time without ticks
        way = np.zeros(len(positions)) if self._last is None else positions - self._last
        velocities = self._rate * way / ticks
        self._last, self._last_tick = positions, sample.tick
        self._state.header.stamp = stamps.to_stamp(nanoseconds)
        self._state.position, self._state.velocity = positions.tolist(), velocities.tolist()
        self._states.publish(self._state)

    def _on_command(self, message: JointState) -> None:
        if self._joints is None:
            return
        commanded = dict(zip(message.name, message.position, strict=False))
        try:
            upper, lower = (self._pose(joints, commanded) for joints in self._joints)
        except IsfError as error:
            if str(error) != self._told:  # not with every message
                self._told = str(error)
                self._node.report(error)
            return
        if upper is not None:
            other = self._parked[1] if lower is None else lower[0]  # else a tool that the job does not have
            self._take(Command(stamps.to_nanoseconds(message.header.stamp), (upper[0], other), upper[1]))
        elif self._told != NOTHING:
            self._told = NOTHING
            names = ", ".join(self._joints[0].names)
            advice = "its joints have to be those of isf describe --ros2-control"
            self._node.report(
                IsfError(ErrorCode.TARGET_NOT_FINITE, f"{NOTHING} {names}", where=COMMANDS, advice=advice)
            )

    @staticmethod
    def _pose(joints: ToolJoints, commanded: dict[str, float]) -> tuple[Vector, Vector] | None:
        """Tip and axis; NaN where a position is, as before a controller is active, None where joints are missing."""
        if not set(joints.names) <= set(commanded):
            return None
        positions = [commanded[name] for name in joints.names]
        if not all(math.isfinite(value) for value in positions):
            return (math.nan, math.nan, math.nan), UPRIGHT
        return joints.pose(positions)


NOTHING = "commands come without positions of"


def near(command: Command, sample: MachineSample) -> bool:
    """True when ``command`` is where the tools of ``sample`` are; never of one that is not finite."""
    pairs = zip(command.tips, (sample.tip_1, sample.tip_2), strict=True)
    return all(math.dist(there, here) < NEAR for there, here in pairs)
