"""A chain of nested loops as one smooth family, so that a path can run between two of them.

Every loop gets the same phases, matched to its neighbour by the shortest way across, not by its arc length: corners
stay opposite corners. Between the loops cubic pieces keep the direction continuous (Fritsch and Carlson's slopes, so
that the level never turns back). Phase 0 to 1 is once around, and the coordinate of the family is w = 0 on the
first loop, 1 on the second and so on; beyond both ends the end loops are repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

PROPORTIONAL = 0.05
"""Part of the arc-length matching mixed in, so that no stretch of a loop shrinks to one phase."""


@dataclass(frozen=True)
class LoopFamily:
    """K loops at M common phases.

    Attributes
    ----------
    points : (K, M, 3) m, in the order of the family
    slope : (K, M, 3) m, derivative by the coordinate w of the family at the loops
    """

    points: Array
    slope: Array

    def __len__(self) -> int:
        return len(self.points)

    def perimeter(self) -> Array:
        """(K,) m, length of every loop in the plane."""
        step = np.roll(self.points, -1, axis=1)[..., :2] - self.points[..., :2]
        return np.asarray(np.linalg.norm(step, axis=2).sum(axis=1))

    def at(self, w: Array, phase: Array) -> Array:
        """(N, 3) m, points at the coordinates w (N,) and phases (N,)."""
        w = np.clip(w, 0.0, len(self) - 1.0)
        lower = np.minimum(w.astype(np.int64), max(len(self) - 2, 0))
        upper = np.minimum(lower + 1, len(self) - 1)
        u = (w - lower)[:, None]
        a, b = self._along(self.points, lower, phase), self._along(self.points, upper, phase)
        da, db = self._along(self.slope, lower, phase), self._along(self.slope, upper, phase)
        rise = (3.0 - 2.0 * u) * u**2
        return np.asarray(a + rise * (b - a) + u * (1 - u) ** 2 * da - u**2 * (1 - u) * db)

    def gap(self) -> Array:
        """(K - 1,) m, largest horizontal distance between neighbouring loops at the same phase."""
        return np.asarray(np.linalg.norm(np.diff(self.points[..., :2], axis=0), axis=2).max(axis=1))

    def _along(self, values: Array, loop: NDArray[np.int64], phase: Array) -> Array:
        count = values.shape[1]
        place = np.mod(phase, 1.0) * count
        first = np.minimum(place.astype(np.int64), count - 1)
        share = (place - first)[:, None]
        return np.asarray(values[loop, first] * (1 - share) + values[loop, (first + 1) % count] * share)


def family(loops: Sequence[Array], spacing: float) -> LoopFamily:
    """Family of closed loops (N_k, 3) m, neighbours nested in each other, with phases about ``spacing`` m apart.

    Phase 0 is the first point of the first loop.
    """
    lengths = [_length(loop) for loop in loops]
    count = max(48, int(np.ceil(max(lengths) / spacing)))
    # matched from the longest loop on: its corners are never skipped
    from_last = lengths[-1] > lengths[0]
    rows = [_resampled(loop, np.arange(count) / count) for loop in loops[:: -1 if from_last else 1][:1]]
    for loop in list(loops[:: -1 if from_last else 1])[1:]:
        rows.append(_resampled(loop, matched(rows[-1][:, :2], loop[:, :2])))
    if from_last:
        rows = rows[::-1]
        shift = int(np.argmin(np.linalg.norm(rows[0][:, :2] - loops[0][0, :2], axis=1)))
        rows = [np.roll(row, -shift, axis=0) for row in rows]
    points = np.array(rows)
    if len(points) < 2:
        return LoopFamily(points, np.zeros_like(points))
    ends = np.concatenate([points[:1], points, points[-1:]])
    nodes = np.arange(-1.0, len(points) + 1.0)
    slope = PchipInterpolator(nodes, ends, axis=0).derivative()(nodes[1:-1])
    return LoopFamily(points, np.asarray(slope))


def matched(points: Array, loop: Array, *, closed: bool = True) -> Array:
    """(M,) share of the closed ``loop`` (N, 2) that lies opposite each of the ``points`` (M, 2), ascending.

    Points and loop run in the same sense. The first value is within 0..1, the others follow without a jump;
    ``closed``: the points go exactly once around.
    """
    ring = shapely.LinearRing(loop)
    nearest = np.asarray(shapely.line_locate_point(ring, shapely.points(points))) / ring.length
    if not closed:
        return _never_falling(np.unwrap(nearest, period=1.0))
    even = np.arange(len(points)) / len(points)
    turned = nearest - nearest[0]
    turned -= np.round(turned - even)
    smooth = np.clip(_never_falling(turned), turned[0] - 0.02, turned[0] + 1.0)
    return np.asarray(nearest[0] + (1 - PROPORTIONAL) * smooth + PROPORTIONAL * even)


def _never_falling(values: Array) -> Array:
    """(M,) ascending values: midway between the largest so far and the smallest still to come."""
    largest = np.maximum.accumulate(values)
    smallest = np.minimum.accumulate(values[::-1])[::-1]
    return np.asarray(0.5 * (largest + smallest))


def _length(loop: Array) -> float:
    return float(np.linalg.norm(np.roll(loop, -1, axis=0)[:, :2] - loop[:, :2], axis=1).sum())


def _resampled(loop: Array, share: Array) -> Array:
    """Points (M, 3) of a closed loop (N, 3) at shares of its length in the plane."""
    closed = np.vstack([loop, loop[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed[:, :2], axis=0), axis=1))])
    return np.column_stack([np.interp(np.mod(share, 1.0) * arc[-1], arc, column) for column in closed.T])
