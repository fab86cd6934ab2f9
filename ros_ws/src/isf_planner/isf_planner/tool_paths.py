"""From the loops of a part to the contours the tools follow, in the order of forming.

Features are formed one after the other, parents before children, each from the flange away; both tools are lifted
between features. Within a feature the loops become separate contours, contours joined by ramps, or one spiral, in the
direction the job asks for.

A feature that rises above the blank, or from a floor, is formed by the lower tool, which touches the other face of the
sheet, one thickness below the given surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from isf_core.contour import Contour
from isf_core.job import Job, JobFile
from numpy.typing import NDArray

from isf_planner import feed_profile, floor_passes, formed_thickness, joined_paths
from isf_planner.contours import contour_of, path_of
from isf_planner.joined_paths import TipPath
from isf_planner.sides import UPSIDE_DOWN, Side, first_number, swapped
from isf_planner.slicing import signed_area
from isf_planner.tip_loops import TipLoop

Array = NDArray[np.float64]


def make_contours(sides: Sequence[Side], job_file: JobFile, plan_id: str) -> tuple[Contour, ...]:
    """Contours of all loops, upper tool first.

    Parameters
    ----------
    sides : loops, features and sampled target as the forming tool of each side sees them
    job_file : the job with its rig and material
    plan_id : of the plan

    Raises
    ------
    IsfError : PATH_BROKEN, PART_TOO_SMALL_FOR_TOOL (flat tip), FEATURES_MIXED (no lower tool)
    """
    job = job_file.job
    chains = [
        (side, feature, number, [side.tree.loops[k] for k in feature.loops])
        for index, side in enumerate(sides)
        for number, feature in enumerate(side.tree.features, first_number(sides, index))
        if feature.loops
    ]
    groups = [feature_paths(chain, side, job) for side, *_, chain in chains]
    for (side, feature, *_), paths in zip(chains, groups, strict=True):
        if not feature.island and not side.tree.children(feature.number):
            over = floor_passes.floor_paths(side.surface, paths[-1], swapped(job, side.forming_tool))
            paths += [_staggered(path, k * job.path.stagger) for k, path in enumerate(over, 1)]
    count = sum(len(paths) for paths in groups)
    contours: list[Contour] = []
    joins: list[bool] = []
    for (side, _, number, chain), paths in zip(chains, groups, strict=True):
        formed = formed_thickness.along(chain, paths, swapped(job, side.forming_tool))
        first: Array | None = None
        for k, (path, thickness) in enumerate(zip(paths, formed, strict=True)):
            seen = replace(_in_sheet(path, side), feature=number)
            contour = contour_of(
                seen, job, plan_id, len(contours), count, formed=thickness, first=first, base=side.base
            )
            if job.path.support == "on_blank" and contour.has_support and first is None:
                first = contour.support_tip
            contours.append(replace(contour, retract=k == 0 and bool(contours)))
            joins.append(path.joins)
    return tuple(feed_profile.with_speed(contours, joins, job.path.acceleration))


def feature_paths(chain: Sequence[TipLoop], side: Side, job: Job) -> list[TipPath]:
    """Paths of one feature's loops in the style and sense of travel the job asks for, as the forming tool sees them."""
    options = job.path
    radius, spacing = swapped(job, side.forming_tool).tool_1.ball_radius, options.point_spacing
    paths = [_directed(path_of(loop), options.direction, k) for k, loop in enumerate(chain)]
    if len(chain) < 2 or (options.style == "contours" and options.transition == "step"):
        return [_staggered(path, k * options.stagger) for k, path in enumerate(paths)]
    if options.style == "spiral":
        return joined_paths.spiral(side.surface, paths, radius, spacing)
    return joined_paths.ramps(side.surface, paths, options.ramp_length, radius, spacing)


def _directed(path: TipPath, direction: str, number: int) -> TipPath:
    """A closed path in the sense of travel asked for, whether it goes around a pocket or an island."""
    clockwise = signed_area(path.points[:, :2]) < 0
    wanted = direction == "cw" or (direction == "alternating" and number % 2 == 1)
    return path if clockwise == wanted else path.turned()


def _staggered(path: TipPath, distance: float) -> TipPath:
    """A closed path started ``distance`` m further along."""
    length = float(np.linalg.norm(np.roll(path.points, -1, axis=0) - path.points, axis=1).sum())
    shift = round(np.mod(distance, length) / length * len(path.points))
    return replace(path, points=np.roll(path.points, -shift, axis=0), normal=np.roll(path.normal, -shift, axis=0))


def _in_sheet(path: TipPath, side: Side) -> TipPath:
    """A path planned in the view of the side's forming tool, in frame ``sheet``."""
    normal = path.normal * UPSIDE_DOWN if side.forming_tool == 2 else path.normal
    return replace(path, points=side.in_sheet(path.points), normal=normal, forming_tool=side.forming_tool)
