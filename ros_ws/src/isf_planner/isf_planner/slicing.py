"""Levels of a part and the closed loop of the tool tip at each level.

The loop at level z is the level line of the tip surface (:mod:`isf_planner.tip_surface`): the border between where
the tip may be at z and where it would cut into the target. Rule for what lies exactly on a level (floors,
terraces, vertices of the mesh): it counts as below, so the loop runs around it. Numerically every level line is
taken 2 um above its level; the tip then moves at the level itself.
"""

from __future__ import annotations

import contourpy
import numpy as np
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


def loop_at(x: Array, y: Array, height: Array, level: float) -> Array:
    """(N, 2) m, the closed loop around all nodes at or below ``level``, counter-clockwise, first point not repeated.

    Parameters
    ----------
    x, y, height : (nx,), (ny,), (ny, nx) m, a height field that is above the level along its border
    level : m

    Raises
    ------
    IsfError : CONTOUR_LOST (no loop), PROCESS_NOT_SUPPORTED (several loops)
    """
    where = f"level {level * 1e3:.3f} mm"
    lines = contourpy.contour_generator(x, y, height, corner_mask=False).lines(level + LIFT)
    loops = [np.asarray(line, dtype=np.float64) for line in lines if len(line) > 3]
    if not loops:
        raise IsfError(
            ErrorCode.CONTOUR_LOST, "there is no contour", where=where, advice="reduce the tool radius or the depth"
        )
    if len(loops) > 1:
        sizes = sorted(((float(np.ptp(loop, axis=0).max()), loop) for loop in loops), key=lambda pair: -pair[0])
        second = sizes[1][1].mean(axis=0) * 1e3
        raise IsfError(
            ErrorCode.PROCESS_NOT_SUPPORTED,
            f"{len(loops)} separate loops, the second around x = {second[0]:.1f}, y = {second[1]:.1f} mm",
            where=where,
            advice="parts with several pockets or islands must be split into single features",
        )
    loop = loops[0]
    if not np.array_equal(loop[0], loop[-1]):
        raise IsfError(ErrorCode.CONTOUR_LOST, "the contour is not closed", where=where, advice="add a plane flange")
    loop = loop[:-1]
    return loop if signed_area(loop) > 0 else loop[::-1]


def signed_area(loop: Array) -> float:
    """m^2, positive for a counter-clockwise closed loop (N, 2)."""
    following = np.roll(loop, -1, axis=0)
    return float(0.5 * np.sum(loop[:, 0] * following[:, 1] - following[:, 0] * loop[:, 1]))
