"""Whether the sheet folds over when a tool forms the next shape of a chain (Behera 2015 eq. 1).

The tool of radius R that follows a wall of the angle alpha touches the sheet along a fillet whose tangents are
d = R tan(alpha / 2) long. Where the wall of the shape before is farther away than that, the tool drives a fold of the
sheet before it. The distance is taken horizontally, or along the normal of the new wall, and measured where the new
shape is a wall: steeper than the first shape of a chain may be, which one pass forms anyway. Floors and shallow walls
are further away from their predecessors by nature, and cannot fold.

The source does not print how it measured the distance, and its own experiments take larger steps than the horizontal
one allows: a part that opens from 60 to 80 deg over 35 mm in four passes, where eq. 1 asks for five with R = 5 mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from scipy import ndimage

from isf_planner.surface import height_grid

Measure = Literal["horizontal", "normal"]

FARTHEST = 8.0
"""Distance at which the search for the shape before ends, over the tool radius."""

MOST_POINTS = 4000
"""Points of a shape that are looked at."""

SHARE = 0.995
"""Quantile of the ratios that counts as the largest: single nodes at corners are uncertain by a cell."""


def fold_over_limit(radius: float, wall_angle: Array | float) -> Array:
    """d (m) of eq. 1 for a tool of ``radius`` m at ``wall_angle`` rad."""
    return np.asarray(radius * np.tan(0.5 * np.asarray(wall_angle)))


@dataclass(frozen=True)
class FoldOver:
    """How near a shape comes to folding: ``ratio`` gap over limit (above 1 it may fold), ``gap`` and ``limit`` m at
    ``place`` (3,) m. All zero where the shape has no wall."""

    ratio: float
    gap: float
    limit: float
    place: Array


NONE = FoldOver(0.0, 0.0, 0.0, np.zeros(3))


def fold_over(
    before: HeightMap, after: HeightMap, radius: float, steep: float, measure: Measure = "horizontal"
) -> FoldOver:
    """Fold-over of the shape ``after`` the shape ``before``, on one grid, on walls of more than ``steep`` rad.

    ``radius`` of the tool, m. Where the shape before is nowhere as deep within :data:`FARTHEST` the gap is that.
    """
    pitch = height_grid.pitch_of(after)
    slope_x, slope_y = after.gradient()
    slope = np.hypot(slope_x, slope_y)
    rows, columns = np.nonzero(slope > np.tan(steep))
    if len(rows) == 0:
        return NONE
    stride = max(1, len(rows) // MOST_POINTS)
    rows, columns = rows[::stride], columns[::stride]
    z, tilt = after.z[rows, columns], slope[rows, columns]
    down = -np.stack([slope_y[rows, columns], slope_x[rows, columns]]) / tilt
    # along the normal the ray rises by cos(alpha) where it goes on by sin(alpha)
    rise = np.zeros_like(tilt) if measure == "horizontal" else 1.0 / tilt
    stretch = np.sqrt(1.0 + rise**2)
    step = 0.5 * pitch
    distance = np.full(len(z), np.inf)
    last = before.z[rows, columns] - z
    distance[last <= 0.0] = 0.0
    for k in range(1, int(FARTHEST * radius / step) + 1):
        at = np.stack([rows, columns]) + down * (k * step / pitch)
        here = ndimage.map_coordinates(before.z, at, order=1, mode="nearest") - (z + rise * k * step)
        crossed = np.isinf(distance) & (here <= 0.0)
        share = last[crossed] / np.maximum(last[crossed] - here[crossed], 1e-12)
        distance[crossed] = (k - 1 + share) * step * stretch[crossed]
        last = here
        if not np.isinf(distance).any():
            break
    gap = np.minimum(distance, FARTHEST * radius)
    limit = fold_over_limit(radius, np.arctan(tilt))
    order = np.argsort(gap / limit)
    worst = order[int(SHARE * (len(order) - 1))]
    place = np.array([after.x[columns[worst]], after.y[rows[worst]], z[worst]])
    return FoldOver(float(gap[worst] / limit[worst]), float(gap[worst]), float(limit[worst]), place)
