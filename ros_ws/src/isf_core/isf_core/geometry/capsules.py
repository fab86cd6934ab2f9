"""Distances of capsules, as links of an arm are taken to be, from boxes and from each other. m."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from isf_core.types import Array

_STEPS = 48
"""Of the search along a segment: each leaves 0.62 of it, so the place is found within 1e-10 of its length."""
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


class Box(NamedTuple):
    """A box along the axes: lowest and highest corner, (3,) m each, and what it is."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    name: str


def segment_to_box(start: Array, end: Array, box: Box) -> Array:
    """(...) m from the segments ``start`` to ``end`` (..., 3) m to ``box``; 0 where they cut into it.

    The distance of a point from a convex body is convex along a line, so a search by golden sections finds the least.
    """
    low, high = np.array(box.low), np.array(box.high)

    def away(points: Array) -> Array:
        return np.asarray(np.linalg.norm(points - np.clip(points, low, high), axis=-1))

    return _least(start, end, away)


def segment_to_segment(start: Array, end: Array, other_start: Array, other_end: Array) -> Array:
    """(...) m between segments, each from (..., 3) to (..., 3) m."""
    along = other_end - other_start
    square = np.maximum((along * along).sum(axis=-1), 1e-30)

    def away(points: Array) -> Array:
        share = np.clip(((points - other_start) * along).sum(axis=-1) / square, 0.0, 1.0)
        return np.asarray(np.linalg.norm(points - other_start - share[..., None] * along, axis=-1))

    return _least(start, end, away)


def _least(start: Array, end: Array, away: Callable[[Array], Array]) -> Array:
    """Least of the convex function ``away`` of points along the segments."""
    way = end - start
    low, high = np.zeros(way.shape[:-1]), np.ones(way.shape[:-1])
    for _ in range(_STEPS):
        first, second = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        nearer = away(start + first[..., None] * way) <= away(start + second[..., None] * way)
        low, high = np.where(nearer, low, first), np.where(nearer, second, high)
    return np.minimum(away(start + (0.5 * (low + high))[..., None] * way), np.minimum(away(start), away(end)))
