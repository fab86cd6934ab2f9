"""Passes over the floor of a pocket, which contours on its wall do not reach.

The last contour of a wall leaves the floor inside it standing up as a low dome (pillow). Passes in rings, one tool step
apart, press it down: inwards, then outwards, as often as ``path.floor_rounds`` says, so that what a scan shows after
one round is mended in the next. Only flat floors without anything in them get passes.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from isf_core.contour import Contour
from isf_core.floor_pass import over_floor
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner import resampling, tip_surface
from isf_planner.joined_paths import TipPath
from isf_planner.target_surface import TargetSurface
from isf_planner.tip_loops import GOUGE_TOLERANCE

Array = NDArray[np.float64]

SMALLEST = 0.5
"""Floor steps: radius of the circle as large as the smallest ring."""


def floor_paths(surface: TargetSurface, wall: TipPath, job: Job) -> list[TipPath]:
    """Rings over the floor inside the last path of a feature, in the order of forming; none where it is not flat.

    Parameters
    ----------
    surface : the sampled target as the forming tool sees it ; wall : the last path, as the tool sees it
    job : with the forming tool as tool_1
    """
    step = job.path.floor_step
    if step is None:
        return []
    level = float(wall.points[:, 2].mean())
    rings: list[list[TipPath]] = []
    shape = shapely.Polygon(wall.points[:, :2])
    for number in itertools.count(1):
        inside = shape.buffer(-number * step)
        found = [part for part in _polygons(inside) if part.area >= np.pi * (SMALLEST * step) ** 2]
        if not found:
            break
        rings.append([_ring(part, level, wall, job.path.point_spacing) for part in found])
    passes = [path for ring in rings for path in ring]
    if not all(_flat(surface, path, level, job.tool_1.ball_radius) for path in passes):
        return []
    return [path for turn in range(job.path.floor_rounds) for path in (passes if turn % 2 == 0 else passes[::-1])]


def left_out(contours: Sequence[Contour], job: Job) -> tuple[str, ...]:
    """Warning when passes are asked for and no floor gets any."""
    if job.path.floor_step is None:
        return ()
    if any(over_floor(contour, before) for before, contour in itertools.pairwise(contours)):
        return ()
    return (
        f"path.floor_step {1e3 * job.path.floor_step:g} mm: no floor is passed over; it has to be flat, empty and more "
        "than one step wide inside the last contour",
    )


def _ring(shape: shapely.Polygon, level: float, wall: TipPath, spacing: float) -> TipPath:
    line = np.asarray(shapely.geometry.polygon.orient(shape).exterior.coords)[:-1]
    points = resampling.with_equal_chords(line, spacing, wall.points[0, :2])
    tips = np.column_stack([points, np.full(len(points), level)])
    ring = replace(wall, points=tips, normal=np.tile([0.0, 0.0, 1.0], (len(tips), 1)), joins=False, closed=True)
    ring = replace(ring, wall_right=True)
    return ring if wall.wall_right else ring.turned()


def _polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    parts = shapely.get_parts(shape)
    return [part for part in parts if isinstance(part, shapely.Polygon) and not part.is_empty]


def _flat(surface: TargetSurface, path: TipPath, level: float, radius: float) -> bool:
    height, _ = tip_surface.drop_tool(surface, path.points[:, :2], radius)
    return bool(np.abs(height - level).max() <= GOUGE_TOLERANCE)
