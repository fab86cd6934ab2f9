"""Closed loops with points at equal distances, started beside the start of the loop before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_POINTS = 12
"""A loop gets at least this many points, however short it is."""


def perimeter(loop: Array) -> float:
    """m, length of a closed loop (N, 2)."""
    return _Ring.of(loop).length


def first_start(loop: Array) -> Array:
    """(2,) m, where the loop crosses the ray in +x direction from its centroid, the farthest such point."""
    centre = np.asarray(shapely.Polygon(loop).centroid.coords[0])
    following = np.roll(loop, -1, axis=0)
    below, above = loop[:, 1] <= centre[1], following[:, 1] <= centre[1]
    crossing = np.flatnonzero(below != above)
    a, b = loop[crossing], following[crossing]
    share = (centre[1] - a[:, 1]) / (b[:, 1] - a[:, 1])
    x = a[:, 0] + share * (b[:, 0] - a[:, 0])
    return np.array([x.max(), centre[1]])


def resample(loop: Array, spacing: float, start: Array) -> Array:
    """(M, 2) m, points at equal arc length near ``spacing`` on the closed loop (N, 2), the first nearest ``start``."""
    line = _Ring.of(loop)
    return line.at(line.nearest(start) + line.length * np.arange(line.count(spacing)) / line.count(spacing))


def with_equal_chords(loop: Array, spacing: float, start: Array) -> Array:
    """As :func:`resample`, with equal straight distances between the points also where the loop turns sharply."""
    line = _Ring.of(loop)
    count = line.count(spacing)
    begin = line.nearest(start)
    distance = line.length * np.arange(count + 1) / count
    for _ in range(4):
        chord = np.linalg.norm(np.diff(line.at(begin + distance), axis=0), axis=1)
        reached = np.concatenate([[0.0], np.cumsum(chord)])
        distance = np.interp(reached[-1] * np.arange(count + 1) / count, reached, distance)
    return line.at(begin + distance[:-1])


@dataclass(frozen=True)
class _Ring:
    """A closed loop by arc length: ``points`` (N + 1, 2) m with the first one repeated, at ``arc`` (N + 1,) m."""

    points: Array
    arc: Array

    @staticmethod
    def of(loop: Array) -> _Ring:
        points = np.vstack([loop, loop[:1]])
        chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return _Ring(points, np.concatenate([[0.0], np.cumsum(chord)]))

    @property
    def length(self) -> float:
        return float(self.arc[-1])

    def count(self, spacing: float) -> int:
        return max(FEWEST_POINTS, round(self.length / spacing))

    def at(self, distance: Array) -> Array:
        arc = np.mod(distance, self.length)
        return np.column_stack([np.interp(arc, self.arc, self.points[:, axis]) for axis in range(2)])

    def nearest(self, point: Array) -> float:
        return float(shapely.LinearRing(self.points).project(shapely.Point(point)))
