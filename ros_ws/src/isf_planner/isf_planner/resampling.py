"""Closed loops with points at equal distances, started beside the start of the loop before."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_POINTS = 12
"""A loop gets at least this many points, however short it is."""


def perimeter(loop: Array) -> float:
    """m, length of a closed loop (N, 2)."""
    return float(np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1).sum())


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
    ring = shapely.LinearRing(loop)
    count = max(FEWEST_POINTS, round(ring.length / spacing))
    begin = ring.project(shapely.Point(start))
    distance = np.mod(begin + ring.length * np.arange(count) / count, ring.length)
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(ring, distance)))


def with_equal_chords(loop: Array, spacing: float, start: Array) -> Array:
    """As :func:`resample`, with equal straight distances between the points also where the loop turns sharply."""
    ring = shapely.LinearRing(loop)
    count = max(FEWEST_POINTS, round(ring.length / spacing))
    begin = ring.project(shapely.Point(start))
    distance = ring.length * np.arange(count + 1) / count
    for _ in range(4):
        points = _at(ring, begin + distance)
        chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
        reached = np.concatenate([[0.0], np.cumsum(chord)])
        distance = np.interp(reached[-1] * np.arange(count + 1) / count, reached, distance)
    return _at(ring, begin + distance[:-1])


def _at(ring: shapely.LinearRing, distance: Array) -> Array:
    points = shapely.line_interpolate_point(ring, np.mod(distance, ring.length))
    return np.asarray(shapely.get_coordinates(points))
