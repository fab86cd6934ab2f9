"""Registration of a scan to the frame of the clamp: height and tilt from the sheet beside the clamp, shift of the part.

The sheet next to the clamp is not deformed: a plane through it gives height and tilt, and is undone as a rigid motion.
What the part itself appears shifted by is seen on the walls only. It is measured and, when it is too large, refused; it
is never undone, because on a part that springs back unevenly it cannot be told from springback. The shift of the
scanner is another matter: see :mod:`isf_springback.scan_processing.clamp_edges`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

CLAMP_BAND = 12e-3
"""m beside the clamp that counts as undeformed."""
HUBER = 1.5
_ITERATIONS = 8


@dataclass(frozen=True)
class FlangePlane:
    """z = height + tilt_x x + tilt_y y of the sheet beside the clamp.

    Attributes
    ----------
    height : m ; tilt_x, tilt_y : rad
    noise : m, robust standard deviation of the points about the plane
    points : number of points used
    """

    height: float
    tilt_x: float
    tilt_y: float
    noise: float
    points: int


def flange_plane(points: Array, clamp: tuple[float, float]) -> FlangePlane | None:
    """Plane through the points beside the clamp by Huber's weights; None with too few points on any two sides."""
    half = 0.5 * np.asarray(clamp)
    room = (half - np.abs(points[:, :2])).min(axis=1)
    near = points[(room <= CLAMP_BAND) & (room > -CLAMP_BAND)]
    if len(near) < 100 or np.ptp(near[:, 0]) < 0.5 * clamp[0] or np.ptp(near[:, 1]) < 0.5 * clamp[1]:
        return None
    matrix = np.column_stack([np.ones(len(near)), near[:, :2]])
    weight = np.ones(len(near))
    solution, noise = np.zeros(3), 0.0
    for _ in range(_ITERATIONS):
        solution = np.linalg.lstsq(matrix * weight[:, None], near[:, 2] * weight, rcond=None)[0]
        departure = np.abs(near[:, 2] - matrix @ solution)
        noise = max(1.4826 * float(np.median(departure)), 1e-7)
        weight = np.sqrt(np.minimum(1.0, HUBER * noise / np.maximum(departure, 1e-12)))
    return FlangePlane(float(solution[0]), float(solution[1]), float(solution[2]), noise, len(near))


def levelled(points: Array, plane: FlangePlane) -> Array:
    """(P, 3) m, ``points`` after the rigid motion that brings the plane to z = 0 about the origin."""
    normal = np.array([-plane.tilt_x, -plane.tilt_y, 1.0])
    normal /= np.linalg.norm(normal)
    up = np.array([0.0, 0.0, 1.0])
    axis = np.cross(normal, up)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + cross + cross @ cross / (1.0 + normal[2])
    return np.asarray((points - [0.0, 0.0, plane.height]) @ rotation.T)


def plan_shift(measured: HeightMap, expected: HeightMap, *, steep: float = 0.2) -> tuple[Array, float]:
    """Shift (2,) m in plan of ``measured`` against ``expected`` (same grid), and its standard deviation, m.

    Least squares on the walls (slope over ``steep``) of measured - expected = a + b expected - slope . shift: a and b
    take up even springback and unfinished depth.
    """
    dz_dx, dz_dy = expected.gradient()
    shift, spread = np.zeros(2), float("nan")
    gx, gy = np.meshgrid(expected.x, expected.y)
    wall = np.hypot(dz_dx, dz_dy) > steep
    wall = np.asarray(wall & (np.abs(expected.z) > 0))
    place = np.column_stack([gx[wall], gy[wall]])
    if len(place) < 50:
        return shift, spread
    base = expected.z[wall]
    matrix = np.column_stack([np.ones(len(base)), base, -dz_dx[wall], -dz_dy[wall]])
    for _ in range(6):
        value = measured.at(place + shift) - base
        known = np.isfinite(value)
        if known.sum() < 50:
            return shift, float("nan")
        found, *_ = np.linalg.lstsq(matrix[known], value[known], rcond=None)
        rest = value[known] - matrix[known] @ found
        covariance = np.linalg.pinv(matrix[known].T @ matrix[known]) * float(rest.var())
        spread = float(np.sqrt(covariance[2:, 2:].trace()))
        shift = shift + found[2:]
        if np.linalg.norm(found[2:]) < 1e-6:
            break
    return shift, spread
