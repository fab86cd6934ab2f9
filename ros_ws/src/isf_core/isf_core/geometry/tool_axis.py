"""The axis of a tool: the unit vector from its tip into its shank, without roll. Frame ``sheet``, m, rad.

An upright upper tool has +z, an upright lower tool -z. The tip of a tool stays what it is when the tool is tilted: the
lowest point of an upper ball, the highest one of a lower ball. So a contact, and everything that follows from it, does
not depend on the axis. What a machine with a tilting tool is told is the point where the axis leaves the ball
(:func:`point_on_axis`); upright, that is the tip.

Tilt is given as angles about x, then about y, as the hexapod's kinematics take them (Torrao 2013, eq. 4.22 without
roll). A tool's orientation turns its upright axis into its axis: no rotation for an upright tool, upper or lower.
Functions that speak of orientation and tilt are for the upper tool; of a lower tool they are given, and give, -axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from isf_core.types import Array

UP = np.array([0.0, 0.0, 1.0])
"""Axis of an upright upper tool."""
UPRIGHT = (0.0, 0.0, 1.0)
"""The same as numbers, for what is done at every tick."""

UNIT_TOLERANCE = 1e-6
"""By which the length of an axis may differ from 1."""


def tilt_of(axis: Array) -> Array:
    """(..., 2) rad about x, then y, that turn z into ``axis`` (..., 3)."""
    axis = np.asarray(axis, dtype=np.float64)
    about_x = np.arctan2(0.0 - axis[..., 1], np.hypot(axis[..., 0], axis[..., 2]))
    return np.stack([about_x, np.arctan2(axis[..., 0], axis[..., 2])], axis=-1)


def axis_of(tilt: Array) -> Array:
    """(..., 3), axis of the tilt (..., 2) rad about x, then y."""
    tilt = np.asarray(tilt, dtype=np.float64)
    (sx, sy), (cx, cy) = np.moveaxis(np.sin(tilt), -1, 0), np.moveaxis(np.cos(tilt), -1, 0)
    return np.stack([sy * cx, -sx, cy * cx], axis=-1)


def inclination(axis: Array) -> Array:
    """(...) rad between ``axis`` (..., 3) and upright, of either tool."""
    axis = np.asarray(axis, dtype=np.float64)
    return np.arctan2(np.hypot(axis[..., 0], axis[..., 1]), np.abs(axis[..., 2]))


def angle_between(first: Array, second: Array) -> Array:
    """(...) rad between the axes (..., 3), exact for small angles too."""
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    chord = np.linalg.norm(second - first, axis=-1)
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))


def between(first: Array, second: Array, share: Array) -> Array:
    """(N, 3), axes on the great circle from ``first`` to ``second`` (3,) at the shares (N,) of the way (slerp)."""
    angle = float(angle_between(first, second))
    share = np.asarray(share, dtype=np.float64)[:, None]
    if angle < 1e-9:
        return np.broadcast_to(np.asarray(second, dtype=np.float64), (len(share), 3)).copy()
    mixed = (np.sin((1.0 - share) * angle) * first + np.sin(share * angle) * second) / math.sin(angle)
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1)[:, None])


def quaternion_of(axis: Sequence[float] | Array) -> tuple[float, float, float, float]:
    """Orientation (x, y, z, w) without roll of the tool with ``axis`` (3,); (0, 0, 0, 1) for an upright one."""
    x, y, z = (float(value) for value in axis)
    about_x, about_y = 0.5 * math.atan2(0.0 - y, math.hypot(x, z)), 0.5 * math.atan2(x, z)
    sx, cx, sy, cy = math.sin(about_x), math.cos(about_x), math.sin(about_y), math.cos(about_y)
    return (cy * sx, sy * cx, -sy * sx, cy * cx)  # Ry after Rx


def axis_of_quaternion(quaternion: Sequence[float]) -> tuple[float, float, float]:
    """Axis (3,) of the orientation (x, y, z, w), whatever its roll and length.

    NaN where all four are 0 or one is not finite.
    """
    x, y, z, w = (float(value) for value in quaternion)
    if x == 0.0 and y == 0.0 and w != 0.0 and math.isfinite(z + w):
        return UPRIGHT
    size = x * x + y * y + z * z + w * w
    if not size > 0.0:
        return (math.nan, math.nan, math.nan)
    return (
        2.0 * (x * z + w * y) / size,
        2.0 * (y * z - w * x) / size,
        (w * w + z * z - x * x - y * y) / size,
    )


def point_on_axis(tip: Array, axis: Array, radius: float) -> Array:
    """(..., 3) m, where ``axis`` leaves a ball of ``radius`` m whose lowest (lower tool: highest) point is ``tip``."""
    return np.asarray(tip + radius * _leaning(axis))


def tip_of_point(point: Array, axis: Array, radius: float) -> Array:
    """(..., 3) m, the tip for the ``point`` on the axis: the reverse of :func:`point_on_axis`."""
    return np.asarray(point - radius * _leaning(axis))


def _leaning(axis: Array) -> Array:
    """(..., 3), the upright axis of the same tool less ``axis``."""
    axis = np.asarray(axis, dtype=np.float64)
    upright = np.zeros_like(axis)
    upright[..., 2] = np.copysign(1.0, axis[..., 2])
    return upright - axis


def turn_per_length(points: Array, axis: Array, *, closed: bool) -> Array:
    """(N,) rad/m, by how much the axis (N, 3) turns per way of the points (N, 3) m, the larger of both neighbours."""
    order = np.arange(len(points) + (1 if closed else 0)) % len(points)
    turn = angle_between(axis[order[:-1]], axis[order[1:]])
    way = np.linalg.norm(np.diff(points[order], axis=0), axis=1)
    rate = turn / np.maximum(way, 1e-9)
    if closed:
        return np.maximum(rate, np.roll(rate, 1))
    return np.maximum(np.append(rate, 0.0), np.insert(rate, 0, 0.0))
