"""Registration of a scan to the frame of the clamp: height and tilt from the sheet beside the clamp, shift of the part.

The sheet next to the clamp is not deformed: a plane through it gives height and tilt, and is undone as a rigid motion.
What the part itself appears shifted by is seen on the walls only. It is measured and, when it is too large, refused; it
is never undone, because on a part that springs back unevenly it cannot be told from springback. The shift of the
scanner is another matter: see :func:`find_edges`.

Registration of a scan in plan by the edges of the clamp: the free sheet that is seen ends there on four sides.

Errors of the wall are errors in plan times the slope: a scanner that is registered 0.2 mm off makes a wall of 50 deg
0.24 mm too high on one side and too low on the other, which no shape of a part tells from uneven springback. The frame
of the clamp does; where it stands over the sheet and is in the scan, it is left out before. Where the points do not end
at the clamp (a scanner that does not see so far, or sees a clamp that is flush with the sheet), nothing is found and
nothing is undone; points that are cut off by a window of the scanner, as wide as the clamp, look registered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

CLAMP_BAND = 12e-3
"""m beside the clamp that counts as undeformed."""
OUTSIDE = 3e-3
"""m beyond the edge of the clamp that may be sheet, as a scanner that is not registered sees it."""
HUBER, ALIEN = 1.5, 6.0
"""Robust standard deviations from which a point counts less, and not at all: it is of the clamp, not of the sheet."""
FRAME_HEIGHT = 2e-3
"""m over the sheet beside the clamp from which a point is one of its frame (assumed)."""
_PLANE_ITERATIONS = 8


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
    """Plane through the points beside the clamp by Huber's weights, none for those far off it; None with too few points
    on any two sides."""
    half = 0.5 * np.asarray(clamp)
    room = (half - np.abs(points[:, :2])).min(axis=1)
    near = points[(room <= CLAMP_BAND) & (room > -OUTSIDE)]
    if len(near) < 100 or np.ptp(near[:, 0]) < 0.5 * clamp[0] or np.ptp(near[:, 1]) < 0.5 * clamp[1]:
        return None
    matrix = np.column_stack([np.ones(len(near)), near[:, :2]])
    solution, noise = np.array([np.median(near[:, 2]), 0.0, 0.0]), 0.0
    for _ in range(_PLANE_ITERATIONS):
        departure = np.abs(near[:, 2] - matrix @ solution)
        noise = max(1.4826 * float(np.median(departure)), 1e-7)
        weight = np.sqrt(np.minimum(1.0, HUBER * noise / np.maximum(departure, 1e-12)))
        weight[departure > ALIEN * noise] = 0.0
        solution = np.linalg.lstsq(matrix * weight[:, None], near[:, 2] * weight, rcond=None)[0]
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


def without_frame(points: Array, clamp: tuple[float, float]) -> tuple[Array, bool]:
    """The levelled ``points`` (P, 3) m without those of a frame of the clamp that stands over the sheet, and whether
    one was seen all around: then the sheet ends there, and not the sight of the scanner."""
    half = 0.5 * np.asarray(clamp)
    room = (half - np.abs(points[:, :2])).min(axis=1)
    frame = (room < CLAMP_BAND) & (points[:, 2] > FRAME_HEIGHT)
    within = half - CLAMP_BAND - np.abs(points[frame, :2])
    sides = [
        bool(((within[:, axis] < 0.0) & (within[:, 1 - axis] > 0.0) & (sign * points[frame, axis] > 0.0)).any())
        for axis in (0, 1)
        for sign in (-1, 1)
    ]  # and not its corners, which belong to two
    return points[~frame], all(sides)


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


BIN = 5e-3
"""m along an edge in which the outermost point counts."""
LENGTH = 0.9
"""Share of an edge that is used: corners are rounded or hidden."""
REACH = 8e-3
"""m around the expected edge in which points belong to it."""
FEWEST_BINS = 0.5
"""Share of the bins of an edge in which points must have been seen."""
LARGEST_MISFIT = 1.5e-3
"""m, difference of the width that is seen from that of the clamp, and the robust scatter of an edge: a spacing of
points of 1 mm and a half (assumed)."""
FRAMED_MISFIT = 8e-3
"""m, difference of the width where the frame of the clamp is seen to begin: the sheet is as wide as that (assumed)."""
_EDGE_ITERATIONS = 8


@dataclass(frozen=True)
class ClampEdges:
    """Place of the clamp in a scan.

    Attributes
    ----------
    shift : (2,) m, of the middle of the clamp ; turn : rad about z
    deviation : m, standard deviation of a component of ``shift``
    """

    shift: Array
    turn: float
    deviation: float


class _Edge(NamedTuple):
    """Reach of an edge from the middle, m, its slope and robust scatter, m."""

    reach: float
    slope: float
    scatter: float


def find_edges(points: Array, clamp: tuple[float, float], *, framed: bool = False) -> ClampEdges | None:
    """Edges of the clamp of ``clamp`` m x m in the points (P, 3) m; None where the points do not end there. ``framed``:
    a frame around the points was seen (:func:`without_frame`)."""
    shift, turns, deviations = np.zeros(2), [], []
    for axis in (0, 1):
        far, near = (
            _edge(side * points[:, axis], points[:, 1 - axis], clamp[axis], clamp[1 - axis]) for side in (1, -1)
        )
        if far is None or near is None:
            return None
        scatter = (far.scatter, near.scatter)
        misfit = FRAMED_MISFIT if framed else LARGEST_MISFIT
        if abs(far.reach + near.reach - clamp[axis]) > misfit or max(scatter) > LARGEST_MISFIT:
            return None
        shift[axis] = 0.5 * (far.reach - near.reach)
        sense = -1.0 if axis == 0 else 1.0
        turns += [sense * far.slope, -sense * near.slope]
        deviations.append(0.5 * float(np.hypot(*scatter)) / np.sqrt(LENGTH * clamp[1 - axis] / BIN))
    return ClampEdges(shift, float(np.mean(turns)), max(deviations))


def undone(points: Array, edges: ClampEdges) -> Array:
    """(P, 3) m, ``points`` with the clamp where it belongs."""
    c, s = np.cos(edges.turn), np.sin(edges.turn)
    plan = (points[:, :2] - edges.shift) @ np.array([[c, -s], [s, c]])
    return np.column_stack([plan, points[:, 2]])


def _edge(outward: Array, along: Array, width: float, length: float) -> _Edge | None:
    """Line through the outermost points over ``along`` (P,) m; None where too few are seen.

    Huber's weights: a hole in the scan at the edge moves it inwards in some bins.
    """
    close = np.abs(outward - 0.5 * width) < REACH
    outward, along = outward[close], along[close]
    bins = max(4, round(LENGTH * length / BIN))
    number = np.floor((along / (LENGTH * length) + 0.5) * bins).astype(np.int64)
    inside = (number >= 0) & (number < bins)
    outermost = np.full(bins, -np.inf)
    np.maximum.at(outermost, number[inside], outward[inside])
    seen = np.isfinite(outermost)
    if seen.sum() < FEWEST_BINS * bins:
        return None
    place = (np.flatnonzero(seen) + 0.5 - 0.5 * bins) * LENGTH * length / bins
    matrix, reach = np.column_stack([np.ones(len(place)), place]), outermost[seen]
    weight, scatter, line = np.ones(len(place)), 0.0, np.zeros(2)
    for _ in range(_EDGE_ITERATIONS):
        line = np.linalg.lstsq(matrix * weight[:, None], reach * weight, rcond=None)[0]
        departure = np.abs(reach - matrix @ line)
        scatter = max(1.4826 * float(np.median(departure)), 1e-7)
        weight = np.sqrt(np.minimum(1.0, 1.5 * scatter / np.maximum(departure, 1e-12)))
    return _Edge(float(line[0]), float(line[1]), scatter)
