"""What programs say of the arms that carry the tools: frames, orientations of the flange, joints.

The flange has z along the axis of the last joint, as ``tool0`` of ROS-Industrial and $FLANGE of KUKA have it.
"""

from __future__ import annotations

import numpy as np
from isf_core.geometry.hexapod import rotation
from isf_core.geometry.serial_arm import SerialArm
from isf_core.types import Array

MM = 1e3
_FLANGE = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Axes of the flange in the last link: a quarter turn about y."""


def frame_fields(arm: SerialArm, tool: int) -> dict[str, float]:
    """Fields that hold for the whole program: frame ``sheet`` in the base of the arm, and the tip in the flange."""
    turned = rotation(np.array(arm.turn)).T
    place = -MM * turned @ np.array(arm.place)
    tip = MM * _FLANGE.T @ (arm.tool * arm.along + np.array([arm.flange, 0.0, 0.0]))
    angles, quaternion = _said(turned[None])
    named = [*zip("xyz", place, strict=True), *zip("abc", angles[0], strict=True)]
    fields = {f"s{name}{tool}": float(value) for name, value in named}
    fields |= {f"sq{name}{tool}": float(value) for name, value in zip("wxyz", quaternion[0], strict=True)}
    return fields | {f"t{name}{tool}": float(value) for name, value in zip("xyz", tip, strict=True)}


def pose_fields(arm: SerialArm, tool: int, tips: Array, tilts: Array) -> tuple[tuple[str, ...], Array]:
    """Names (F,) and values (N, F) of the fields of every point: orientation of the flange and joints.

    ``tips`` (N, 3) m, ``tilts`` (N, 2) rad
    """
    joints = arm.held(tips, tilts)[0]
    angles, quaternion = _said(arm.forward(joints)[1] @ _FLANGE)
    names = [f"k{name}{tool}" for name in ("a", "b", "c", "qw", "qx", "qy", "qz")]
    names += [f"j{n}_{tool}" for n in range(1, 7)]
    return tuple(names), np.column_stack([angles, quaternion, np.degrees(joints)])


def _said(turned: Array) -> tuple[Array, Array]:
    """(N, 3) deg about z, y, x, and (N, 4) quaternion w x y z, of (N, 3, 3); of angles and quaternions that mean the
    same the same one every time: 180 deg, and the first component that is not 0 positive."""
    from scipy.spatial.transform import Rotation  # late: 0.1 s that other formats need not pay

    found = Rotation.from_matrix(turned)
    angles = np.round(found.as_euler("ZYX", degrees=True), 9)
    angles[angles <= -180.0 + 1e-6] += 360.0
    quaternion = np.round(np.roll(found.as_quat(), 1, axis=1), 12)
    first = np.argmax(np.abs(quaternion) > 1e-6, axis=1)
    sign = np.sign(quaternion[np.arange(len(first)), first])
    return angles + 0.0, quaternion * sign[:, None] + 0.0
