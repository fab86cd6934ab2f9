"""Levels at constant incremental depth, constant scallop height or constant distance down the wall.

Of the surface on which the tip moves, every height has a slope: that of the flattest twentieth of its level line. On
it the tip goes down by dz = s sin(a) when its centre moves on by s at the wall angle a. For contacts at a distance d
along the wall, s = d / (1 + R k), and for ridges of height h between neighbouring contours s = sqrt(8 R h / (1 + R k)),
with the tool radius R and the curvature k of the centre's path down the wall (ridge between two circles whose centres
lie s apart, for h << R). Steps are kept between the smallest and the largest one; all are then shortened alike so that
the last one ends at the full depth.
"""

from __future__ import annotations

import numpy as np
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner import slicing
from isf_planner.sections import TipGrid

Array = NDArray[np.float64]

FLATTEST_SHARE = 0.05
"""Share of a level line, by length, that is flatter than the slope used."""

BANDS = 400
"""Heights at which the slope is looked at."""


def levels(grid: TipGrid, job: Job) -> Array:
    """(K,) m, falling, z of the tip at every level, the last one at the full depth, by the job's ``path.spacing``."""
    path = job.path
    if path.spacing == "depth":
        return slicing.levels(grid.depth, path.incremental_depth)
    radius = job.tool_1.ball_radius
    z, angle = _slopes(grid)
    bend = 1.0 + radius * np.sin(angle) * np.gradient(angle, z)
    bend = np.clip(bend, 0.2, 5.0)
    if path.spacing == "arc":
        along = path.arc_step / bend
    else:
        along = np.sqrt(8.0 * radius * path.scallop_height / bend)
    largest = path.largest_step or path.incremental_depth
    step = np.clip(along * np.sin(angle), min(path.smallest_step, largest), largest)
    # number of steps from the top down to every height
    thickness = -np.diff(z)
    passed = np.concatenate([[0.0], np.cumsum(thickness * 0.5 * (1.0 / step[:-1] + 1.0 / step[1:]))])
    count = max(1, int(np.ceil(passed[-1] - slicing.SMALLEST_STEP)))
    found = np.interp(passed[-1] * np.arange(1, count + 1) / count, passed, z)
    found[-1] = -grid.depth
    return np.asarray(found)


def _slopes(grid: TipGrid) -> tuple[Array, Array]:
    """Heights (B + 1,) m from 0 down to the full depth and the wall angle (rad) of the flattest part of each."""
    dy, dx = np.gradient(grid.height, grid.y, grid.x)
    tangent = np.hypot(dx, dy)
    formed = (grid.height < -1e-6) & (grid.height > -grid.depth + 1e-6)
    band = np.minimum((-grid.height[formed] / grid.depth * BANDS).astype(np.int64), BANDS - 1)
    slope = tangent[formed]
    order = np.lexsort([slope, band])
    band, slope = band[order], slope[order]
    begin = np.searchsorted(band, np.arange(BANDS + 1))
    found = np.full(BANDS, np.nan)
    for k in range(BANDS):
        part = slope[begin[k] : begin[k + 1]]
        if len(part):  # nodes stand for areas: the length of the level line goes with area times slope
            reached = np.cumsum(part)
            found[k] = part[min(np.searchsorted(reached, FLATTEST_SHARE * reached[-1]), len(part) - 1)]
    known = np.flatnonzero(np.isfinite(found))
    centre = -(np.arange(BANDS) + 0.5) * grid.depth / BANDS
    z = np.linspace(0.0, -grid.depth, BANDS + 1)
    if len(known) == 0:
        return z, np.full(BANDS + 1, np.pi / 4)
    smooth = np.convolve(
        np.pad(np.interp(np.arange(BANDS), known, found[known]), 3, mode="edge"), np.ones(7) / 7, "valid"
    )
    return z, np.arctan(np.interp(-z, -centre, smooth))
