"""Whether the sheet folds over when a tool forms the next shape of a chain (Behera 2015 eq. 1).

The tool of radius R that follows a wall of the angle alpha touches the sheet along a fillet whose tangents are
d = R tan(alpha / 2) long. Where the wall of the shape before is farther away than that, the tool drives a fold of the
sheet before it. The distance is that of the level lines of both shapes, or its part along the normal of the new wall,
measured where the new shape is steeper than the first one of a chain may be, which one pass forms anyway. This is
strict: a wall that goes deeper than the whole shape before counts as :data:`FARTHEST` away from it.

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

LEVELS = 24
"""Heights at which the level lines of two shapes are compared."""

INSIDE = 0.93
"""Nodes less steep than this share of a neighbour lie on an edge of the wall: their slope is a mean of both sides."""

SHARE = 0.99
"""Quantile of the ratios that counts as the largest: single nodes at corners are uncertain by a cell."""


def fold_over_limit(radius: float, wall_angle: Array | float) -> Array:
    """d (m) of eq. 1 for a tool of ``radius`` m at ``wall_angle`` rad."""
    return np.asarray(radius * np.tan(0.5 * np.asarray(wall_angle)))


@dataclass(frozen=True)
class FoldOver:
    """How near a shape comes to folding: ``ratio`` gap over limit (above 1 it may fold), ``gap`` and ``limit`` m at
    ``place`` (3,) m. All zero where the shape has no wall, or is the one before; ``at_least``: the wall before is
    farther away than was looked, so ``gap`` and ``ratio`` are more."""

    ratio: float
    gap: float
    limit: float
    place: Array
    at_least: bool = False

    @property
    def gap_text(self) -> str:
        """The gap for people."""
        return f"{'at least ' if self.at_least else ''}{self.gap * 1e3:.1f} mm"


UNCHANGED = FoldOver(0.0, 0.0, 0.0, np.zeros(3))


def fold_over(
    before: HeightMap, after: HeightMap, radius: float, steep: float, measure: Measure = "horizontal"
) -> FoldOver:
    """Fold-over of the shape ``after`` the shape ``before``, on one grid, on walls of more than ``steep`` rad.

    ``radius`` of the tool, m.
    """
    pitch = height_grid.pitch_of(after)
    slope, slope_before = (np.hypot(*shape.gradient()) for shape in (after, before))
    whole = slope > INSIDE * ndimage.maximum_filter(slope, 3)
    rows, columns = np.nonzero(whole & (slope > np.tan(steep)))
    if len(rows) == 0:
        return UNCHANGED
    z, tilt = after.z[rows, columns], slope[rows, columns]
    gap = np.full(len(z), np.inf)
    levels = np.linspace(z.min(), z.max(), LEVELS)
    nearest_level = np.argmin(np.abs(z[:, None] - levels), axis=1)
    for k, level in enumerate(levels):
        mine = np.flatnonzero(nearest_level == k)
        deep = before.z <= level
        if len(mine) == 0 or not deep.any():
            continue
        distance, (row, column) = ndimage.distance_transform_edt(~deep, return_indices=True)
        row, column = row[rows[mine], columns[mine]], column[rows[mine], columns[mine]]
        # from the point to the level on its own wall, and from there to where the wall before crosses the level
        own = (z[mine] - level) / tilt[mine]
        beyond = np.minimum((level - before.z[row, column]) / np.maximum(slope_before[row, column], 1e-3), pitch)
        gap[mine] = np.maximum(distance[rows[mine], columns[mine]] * pitch - own - beyond, 0.0)
    beyond_search = gap >= FARTHEST * radius
    gap = np.minimum(gap, FARTHEST * radius)
    if measure == "normal":
        gap = gap * np.sin(np.arctan(tilt))
    limit = fold_over_limit(radius, np.arctan(tilt))
    order = np.argsort(gap / limit)
    worst = order[int(SHARE * (len(order) - 1))]
    place = np.array([after.x[columns[worst]], after.y[rows[worst]], z[worst]])
    ratio = float(gap[worst] / limit[worst])
    return FoldOver(ratio, float(gap[worst]), float(limit[worst]), place, bool(beyond_search[worst]))
