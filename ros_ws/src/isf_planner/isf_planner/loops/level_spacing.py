"""The levels of a part: at constant incremental depth, constant scallop height or constant distance down the wall.

Of the surface on which the tip moves, every height has a slope: that of the flattest twentieth of its level line. When
the tip goes down by dz at the wall angle a, its centre moves on by s = dz / sin(a) and the contact by d = s - R da,
with the tool radius R. Contours at a distance down the wall divide the sum of d, ridges of height h between them that
of sqrt(s d / (8 R h)) (ridge between two circles whose centres lie s apart, for h << R). Angles are those at the
contacts of balls dropped on the surface, so that jumps of the curvature, where fillets begin and end, stay sharp. Steps
are kept between the smallest and the largest one; all are then shortened alike so that the last one ends at the full
depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.files.job import Job, PathSpec
from isf_core.types import Array, Indices, Mask

from isf_planner.loops import tip_loops
from isf_planner.loops.sections import TipGrid
from isf_planner.surface import tip_surface
from isf_planner.surface.target_surface import TargetSurface

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


@dataclass(frozen=True)
class Places:
    """N places, evenly over what is formed, with a ball dropped on each.

    Attributes
    ----------
    height : (N,) m, of the tip ; slope : (N,) tangent of the wall angle at the contact ; contact : (N, 2) m
    """

    height: Array
    slope: Array
    contact: Array

    def __len__(self) -> int:
        return len(self.height)

    def of(self, chosen: Mask | Indices) -> Places:
        """Some of them."""
        return Places(self.height[chosen], self.slope[chosen], self.contact[chosen])


def levels(grid: TipGrid, surface: TargetSurface, job: Job) -> Array:
    """(K,) m, falling, z of the tip at every level, the last one at the full depth, by the job's ``path.spacing``.

    ``grid`` holds the tip on the ``surface``.
    """
    if job.path.spacing == "depth":
        return tip_loops.levels(grid.depth, job.path.incremental_depth)
    radius = job.tool_1.ball_radius
    z = np.linspace(0.0, -grid.depth, BANDS + 1)
    found = places(grid, surface, radius)
    angle = wall_angles(z, found) if len(found) else np.full(BANDS + 1, np.pi / 4)
    return divided(z, steps_down(z, angle, job.path, radius))


def places(grid: TipGrid, surface: TargetSurface, radius: float) -> Places:
    """Places on the ``surface``, between flange and full depth, for a ball of ``radius`` m."""
    rows, columns = np.nonzero((grid.height < -1e-6) & (grid.height > -grid.depth + 1e-6))
    if len(rows) == 0:
        return Places(np.empty(0), np.empty(0), np.empty((0, 2)))
    some = np.unique(np.linspace(0, len(rows) - 1, BALLS).astype(np.int64))
    points = np.column_stack([grid.x[columns[some]], grid.y[rows[some]]])
    height, contact = tip_surface.drop_tool(surface, points, radius)
    upward = np.clip(tip_surface.contact_normals(surface, points, contact, radius)[:, 2], 1e-6, 1.0)
    return Places(height, np.sqrt(1.0 - upward**2) / upward, contact)


def wall_angles(z: Array, found: Places) -> Array:
    """(B + 1,) rad at the heights ``z`` (B + 1,) m, evenly falling: of the flattest part of the ``found`` places."""
    count, depth = len(z) - 1, float(z[0] - z[-1])
    band = np.clip(((z[0] - found.height) / depth * count).astype(np.int64), 0, count - 1)
    order = np.lexsort([found.slope, band])
    band, slope = band[order], found.slope[order]
    begin = np.searchsorted(band, np.arange(count + 1))
    flattest = np.full(count, np.nan)
    for k in range(count):
        part = slope[begin[k] : begin[k + 1]]
        if len(part):  # places stand for areas: the length of the level line goes with area times slope
            reached = np.cumsum(part)
            flattest[k] = part[min(np.searchsorted(reached, FLATTEST_SHARE * reached[-1]), len(part) - 1)]
    known = np.flatnonzero(np.isfinite(flattest))
    middle = z[0] - (np.arange(count) + 0.5) * depth / count
    filled = np.pad(np.interp(np.arange(count), known, flattest[known]), SMOOTHED // 2, mode="edge")
    smooth = np.convolve(filled, np.ones(SMOOTHED) / SMOOTHED, "valid")
    return np.maximum(np.arctan(np.interp(-z, -middle, smooth)), FLATTEST_ANGLE)


def steps_down(z: Array, angle: Array, path: PathSpec, radius: float) -> Array:
    """(B + 1,) steps, in fractions too, from the first of the heights ``z`` m down to each, at ``angle`` rad there."""
    down = -np.diff(z)
    centre = down / np.sin(0.5 * (angle[:-1] + angle[1:]))
    contact = np.clip(centre - radius * np.diff(angle), FLATTEST_BEND * centre, centre / FLATTEST_BEND)
    if path.spacing == "arc":
        wanted = contact / path.arc_step
    else:
        wanted = np.sqrt(centre * contact / (8.0 * radius * path.scallop_height))
    largest = path.largest_step or path.incremental_depth
    bounded = np.clip(wanted, down / largest, down / min(path.smallest_step, largest))
    return np.concatenate([[0.0], np.cumsum(bounded)])


def divided(z: Array, steps: Array) -> Array:
    """(K,) m, falling: levels after equal shares of the ``steps`` (B + 1,) down to ``z`` (B + 1,) m, the last at its
    end."""
    count = max(1, int(np.ceil(steps[-1] - tip_loops.SMALLEST_STEP)))
    found = np.interp(steps[-1] * np.arange(1, count + 1) / count, steps, z)
    found[-1] = z[-1]
    return np.asarray(found)
