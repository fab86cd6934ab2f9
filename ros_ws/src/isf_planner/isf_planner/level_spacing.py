"""Levels at constant incremental depth, constant scallop height or constant distance down the wall.

Of the surface on which the tip moves, every height has a slope: that of the flattest twentieth of its level line. When
the tip goes down by dz at the wall angle a, its centre moves on by s = dz / sin(a) and the contact by d = s - R da,
with the tool radius R. Contours at a distance down the wall divide the sum of d, ridges of height h between them that
of sqrt(s d / (8 R h)) (ridge between two circles whose centres lie s apart, for h << R). Angles are those at the
contacts of balls dropped on the surface, so that jumps of the curvature, where fillets begin and end, stay sharp.
Steps are kept between the smallest and the largest one; all are then shortened alike so that the last one ends at the
full depth.
"""

from __future__ import annotations

import numpy as np
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner import slicing, tip_surface
from isf_planner.sections import TipGrid
from isf_planner.target_surface import TargetSurface

Array = NDArray[np.float64]

FLATTEST_SHARE = 0.05
"""Share of a level line, by length, that is flatter than the slope used."""

BANDS = 400
"""Heights at which the slope is looked at."""

FLATTEST_ANGLE = 1e-3
"""rad, so that flat ground has a step at all: the largest one allowed."""

SMOOTHED = 3
"""Bands over which the slope is averaged."""

BALLS = 20_000
"""Places, evenly over the formed region, at which the slope is taken."""

FLATTEST_BEND = 0.2
"""Least and, inverted, largest distance of contacts over that of the centres."""


def levels(grid: TipGrid, surface: TargetSurface, job: Job) -> Array:
    """(K,) m, falling, z of the tip at every level, the last one at the full depth, by the job's ``path.spacing``.

    ``grid`` holds the tip on the ``surface``.
    """
    path = job.path
    if path.spacing == "depth":
        return slicing.levels(grid.depth, path.incremental_depth)
    radius = job.tool_1.ball_radius
    z, angle = _slopes(grid, surface, radius)
    down = -np.diff(z)
    centre = down / np.sin(0.5 * (angle[:-1] + angle[1:]))
    contact = np.clip(centre - radius * np.diff(angle), FLATTEST_BEND * centre, centre / FLATTEST_BEND)
    if path.spacing == "arc":
        wanted = contact / path.arc_step
    else:
        wanted = np.sqrt(centre * contact / (8.0 * radius * path.scallop_height))
    largest = path.largest_step or path.incremental_depth
    # number of steps from the top down to every height
    passed = np.concatenate(
        [[0.0], np.cumsum(np.clip(wanted, down / largest, down / min(path.smallest_step, largest)))]
    )
    count = max(1, int(np.ceil(passed[-1] - slicing.SMALLEST_STEP)))
    found = np.interp(passed[-1] * np.arange(1, count + 1) / count, passed, z)
    found[-1] = -grid.depth
    return np.asarray(found)


def _slopes(grid: TipGrid, surface: TargetSurface, radius: float) -> tuple[Array, Array]:
    """Heights (B + 1,) m from 0 down to the full depth and the wall angle (rad) of the flattest part of each."""
    rows, columns = np.nonzero((grid.height < -1e-6) & (grid.height > -grid.depth + 1e-6))
    z = np.linspace(0.0, -grid.depth, BANDS + 1)
    if len(rows) == 0:
        return z, np.full(BANDS + 1, np.pi / 4)
    some = np.unique(np.linspace(0, len(rows) - 1, BALLS).astype(np.int64))
    points = np.column_stack([grid.x[columns[some]], grid.y[rows[some]]])
    height, contact = tip_surface.drop_tool(surface, points, radius)
    upward = tip_surface.contact_normals(surface, points, contact, radius)[:, 2]
    slope = np.sqrt(1.0 - np.clip(upward, 1e-6, 1.0) ** 2) / np.clip(upward, 1e-6, 1.0)
    band = np.clip((-height / grid.depth * BANDS).astype(np.int64), 0, BANDS - 1)
    order = np.lexsort([slope, band])
    band, slope = band[order], slope[order]
    begin = np.searchsorted(band, np.arange(BANDS + 1))
    found = np.full(BANDS, np.nan)
    for k in range(BANDS):
        part = slope[begin[k] : begin[k + 1]]
        if len(part):  # places stand for areas: the length of the level line goes with area times slope
            reached = np.cumsum(part)
            found[k] = part[min(np.searchsorted(reached, FLATTEST_SHARE * reached[-1]), len(part) - 1)]
    known = np.flatnonzero(np.isfinite(found))
    centre = -(np.arange(BANDS) + 0.5) * grid.depth / BANDS
    filled = np.pad(np.interp(np.arange(BANDS), known, found[known]), SMOOTHED // 2, mode="edge")
    smooth = np.convolve(filled, np.ones(SMOOTHED) / SMOOTHED, "valid")
    return z, np.maximum(np.arctan(np.interp(-z, -centre, smooth)), FLATTEST_ANGLE)
