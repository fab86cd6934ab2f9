"""From the loops of a part to the contours the tools follow, in the order of forming.

Features are formed one after the other, parents before children, each from the flange away; both tools are lifted
between features. Within a feature the loops become separate contours, contours joined by ramps, or one spiral, in the
direction the job asks for.

A loop of a feature with ``forming_tool`` 2 (it rises above the blank) has its contacts on the given surface, too; the
lower tool touches the other face of the sheet, one thickness below it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from isf_core.contour import Contour
from isf_core.job import Job, JobFile
from numpy.typing import NDArray

from isf_planner import feed_profile, formed_thickness, joined_paths
from isf_planner.contours import contour_of, path_of
from isf_planner.feature_tree import LoopTree
from isf_planner.joined_paths import TipPath
from isf_planner.slicing import signed_area
from isf_planner.target_surface import TargetSurface
from isf_planner.tip_loops import TipLoop

Array = NDArray[np.float64]


def make_contours(tree: LoopTree, surface: TargetSurface, job_file: JobFile, plan_id: str) -> tuple[Contour, ...]:
    """Contours of all loops.

    Parameters
    ----------
    tree : loops and features
    surface : the sampled target, on which joined paths are settled
    job_file : the job with its rig and material
    plan_id : of the plan

    Raises
    ------
    IsfError : PATH_BROKEN, PART_TOO_SMALL_FOR_TOOL (flat tip), FEATURES_MIXED (no lower tool)
    """
    job = job_file.job
    chains = [[tree.loops[k] for k in feature.loops] for feature in tree.features]
    groups = [feature_paths(chain, surface, job) for chain in chains if chain]
    count = sum(len(paths) for paths in groups)
    contours: list[Contour] = []
    joins: list[bool] = []
    for chain, paths in zip(chains, groups, strict=True):
        formed = formed_thickness.along(chain, paths, job)
        first: Array | None = None
        for k, (path, thickness) in enumerate(zip(paths, formed, strict=True)):
            contour = contour_of(path, job, plan_id, len(contours), count, formed=thickness, first=first)
            if job.path.support == "on_blank" and contour.has_support and first is None:
                first = contour.support_tip
            contours.append(replace(contour, retract=k == 0 and bool(contours)))
            joins.append(path.joins)
    return tuple(feed_profile.with_speed(contours, joins, job.path.acceleration))


def feature_paths(chain: Sequence[TipLoop], surface: TargetSurface, job: Job) -> list[TipPath]:
    """Paths of one feature's loops in the style and sense of travel the job asks for."""
    options = job.path
    tool = job.tool_1 if chain[0].forming_tool == 1 or job.tool_2 is None else job.tool_2
    radius, spacing = tool.ball_radius, options.point_spacing
    paths = [_directed(path_of(loop), options.direction, k) for k, loop in enumerate(chain)]
    if len(chain) < 2 or (options.style == "contours" and options.transition == "step"):
        return [_staggered(path, k * options.stagger) for k, path in enumerate(paths)]
    lower = chain[0].forming_tool == 2
    if lower:  # joined paths are settled as on a pocket: the part seen from below
        paths = [_mirrored(path) for path in paths]
        surface = replace(surface, z=-surface.z, normal_xy=-surface.normal_xy)
    if options.style == "spiral":
        paths = joined_paths.spiral(surface, paths, radius, spacing)
    else:
        paths = joined_paths.ramps(surface, paths, options.ramp_length, radius, spacing)
    return [_mirrored(path) for path in paths] if lower else paths


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


def _mirrored(path: TipPath) -> TipPath:
    flip = np.array([1.0, 1.0, -1.0])
    return replace(path, points=path.points * flip, normal=path.normal * flip)
