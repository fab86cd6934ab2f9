"""Levels of a part and the closed loop of the tool tip at each level.

The loop at level z is the level line of the tip surface (:mod:`isf_planner.tip_surface`): the border between where
the tip may be at z and where it would cut into the target. Rule for what lies exactly on a level (floors,
terraces, vertices of the mesh): it counts as below, so the loop runs around it. Numerically every level line is
taken 2 um above its level; the tip then moves at the level itself.
"""

from __future__ import annotations

import contourpy
import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIFT = 2e-6
"""m, level lines are taken this much above the level of the tip; also the depth of cut this may cause."""

SMALLEST_STEP = 0.05
"""A last step smaller than this part of the incremental depth is added to the step before."""


def levels(depth: float, incremental_depth: float) -> Array:
    """(K,) m, z of the tip at every level: multiples of the incremental depth, the last one at the full depth."""
    count = max(1, int(np.ceil(depth / incremental_depth - SMALLEST_STEP)))
    return -np.append(incremental_depth * np.arange(1, count), depth)


def loops_at(x: Array, y: Array, height: Array, level: float) -> list[tuple[Array, bool]]:
    """All closed loops at ``level``: points (N, 2) m, first point not repeated, and whether it surrounds an island.

    Pockets (below the level inside) run counter-clockwise, islands in them (above the level inside) clockwise.

    Parameters
    ----------
    x, y, height : (nx,), (ny,), (ny, nx) m, a height field that is above the level along its border
    level : m

    Raises
    ------
    IsfError : CONTOUR_LOST when a loop is not closed
    """
    lines = contourpy.contour_generator(x, y, height, corner_mask=False).lines(level + LIFT)
    loops = []
    for line in lines:
        loop = np.asarray(line, dtype=np.float64)
        if len(loop) <= 3:
            continue
        if not np.array_equal(loop[0], loop[-1]):
            where = f"level {level * 1e3:.3f} mm at x = {loop[0, 0] * 1e3:.1f}, y = {loop[0, 1] * 1e3:.1f} mm"
            raise IsfError(
                ErrorCode.CONTOUR_LOST, "the contour is not closed", where=where, advice="add a plane flange"
            )
        loops.append(loop[:-1])
    islands = _surround_higher_ground(loops)
    return [
        (loop if (signed_area(loop) > 0) != island else loop[::-1], island)
        for loop, island in zip(loops, islands, strict=True)
    ]


def _surround_higher_ground(loops: list[Array]) -> list[bool]:
    """Outside all loops the ground is above the level, and every loop crossed inwards changes the side."""
    if len(loops) < 2:
        return [False] * len(loops)
    shapes = [shapely.Polygon(loop) for loop in loops]
    return [
        sum(other is not shape and shapely.contains_xy(other, *loop[0]) for other in shapes) % 2 == 1
        for loop, shape in zip(loops, shapes, strict=True)
    ]


def signed_area(loop: Array) -> float:
    """m^2, positive for a counter-clockwise closed loop (N, 2)."""
    following = np.roll(loop, -1, axis=0)
    return float(0.5 * np.sum(loop[:, 0] * following[:, 1] - following[:, 0] * loop[:, 1]))
