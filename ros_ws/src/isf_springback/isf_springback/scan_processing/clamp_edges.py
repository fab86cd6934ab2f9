"""Registration of a scan in plan by the edges of the clamp: the free sheet that is seen ends there on four sides.

Errors of the wall are errors in plan times the slope: a scanner that is registered 0.2 mm off makes a wall of 50 deg
0.24 mm too high on one side and too low on the other, which no shape of a part tells from uneven springback. The frame
of the clamp does. Where the points do not end at the clamp (a scanner that sees beyond it, or not so far), nothing is
found and nothing is undone; points that are cut off by a window of the scanner, as wide as the clamp, look registered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from isf_core.types import Array

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
_ITERATIONS = 8


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


def find_edges(points: Array, clamp: tuple[float, float]) -> ClampEdges | None:
    """Edges of the clamp of ``clamp`` m x m in the points (P, 3) m; None where the points do not end there."""
    shift, turns, deviations = np.zeros(2), [], []
    for axis in (0, 1):
        far, near = (
            _edge(side * points[:, axis], points[:, 1 - axis], clamp[axis], clamp[1 - axis]) for side in (1, -1)
        )
        if far is None or near is None:
            return None
        scatter = (far.scatter, near.scatter)
        if abs(far.reach + near.reach - clamp[axis]) > LARGEST_MISFIT or max(scatter) > LARGEST_MISFIT:
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
    for _ in range(_ITERATIONS):
        line = np.linalg.lstsq(matrix * weight[:, None], reach * weight, rcond=None)[0]
        departure = np.abs(reach - matrix @ line)
        scatter = max(1.4826 * float(np.median(departure)), 1e-7)
        weight = np.sqrt(np.minimum(1.0, 1.5 * scatter / np.maximum(departure, 1e-12)))
    return _Edge(float(line[0]), float(line[1]), scatter)
