"""Positions of the joints of a cell from the poses of the tool tips that its driver tells."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import Rig
from isf_core.geometry.hexapod import Hexapod
from isf_core.geometry.tool_axis import UPRIGHT, axis_of_quaternion, tilt_of
from isf_core.geometry.tool_joints import ToolJoints

from isf_description.hexapod import leg_positions
from isf_description.tree import Quaternion, Vector

Positions = dict[str, float]


def tool_positions(rig: Rig, number: int, radius: float) -> Callable[[Vector, Quaternion], Positions]:
    """Function from tip (m, frame ``sheet``) and orientation of tool ``number`` to positions (m, rad) by joint.

    The ball of the tool has ``radius`` m. Of an orientation only the axis counts, and on a gantry nothing.

    The function raises IsfError TARGET_NOT_FINITE, and TARGET_OUT_OF_WORKSPACE where an arm is too short.
    """
    if number == 1 and rig.kinematics == "hexapod_spif_a":
        return _hexapod(rig.hexapod.kinematics(), radius)
    joints = ToolJoints.of(rig, number, radius)
    tilts = rig.arm(number) is not None

    def positions(tip: Vector, turn: Quaternion) -> Positions:
        _check(tip)
        axis = _axis(turn) if tilts else UPRIGHT
        return dict(zip(joints.names, joints.positions(tip, axis).tolist(), strict=True))

    return positions


def _hexapod(machine: Hexapod, radius: float) -> Callable[[Vector, Quaternion], Positions]:
    def positions(tip: Vector, turn: Quaternion) -> Positions:
        _check(tip)
        axis = _axis(turn)
        about_x, about_y = tilt_of(np.array(axis)).tolist()
        tilt = (about_x, about_y)
        own = dict(
            zip(("tool_1_x", "tool_1_y", "tool_1_z", "tool_1_tilt_x", "tool_1_tilt_y"), (*tip, *tilt), strict=True)
        )
        return own | leg_positions(machine, tip, tilt, radius)

    return positions


def _axis(turn: Quaternion) -> Vector:
    axis = axis_of_quaternion(turn)
    if not all(math.isfinite(value) for value in axis):
        raise IsfError(ErrorCode.TARGET_NOT_FINITE, "the orientation is none, as of four zeros", where="pose")
    return axis


def _check(tip: Vector) -> None:
    if not all(math.isfinite(value) for value in tip):
        raise IsfError(ErrorCode.TARGET_NOT_FINITE, "the tip has a coordinate that is no number", where="pose")
