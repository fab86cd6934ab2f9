"""A change of tool on a finished plan: contacts, normals and curvatures stay, tips are made anew and checked.

Contact points take seconds, tips milliseconds. With another forming tool the tip of a point is its contact plus the
radius along the normal; its height then varies along a loop where the wall angle does. Every new tip is checked
against the whole sampled surface: where it cuts in, because the surface bends more there than the ball, the ball is
moved out along the normal of its contact; what would have to move further than a tenth of a millimetre is refused.
A smaller tool that gets further into the part than the one before has other contacts: that takes a new plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job

from isf_planner.checks.part_checks import UNREACHED_TOLERANCE
from isf_planner.forming.sides import Side, swapped
from isf_planner.loops.tip_loops import GOUGE_TOLERANCE, TipLoop
from isf_planner.part.mesh_checks import place_text
from isf_planner.surface import tip_surface
from isf_planner.surface.target_surface import TargetSurface

FURTHEST = 0.1e-3
"""m, largest correction along the normal; more is a tool that does not fit."""

KEPT_SECTIONS = {"name", "part", "process", "rig", "wall_angle_limit", "backing_plate", "die"}
"""Sections of the job that the contacts depend on."""

KEPT_PATH = {
    "incremental_depth",
    "point_spacing",
    "spacing",
    "scallop_height",
    "arc_step",
    "smallest_step",
    "largest_step",
    "islands",
}
"""Fields of ``path`` that the contacts depend on."""


@dataclass(frozen=True)
class PlanBase:
    """What a plan was made from: the job, the loops and sampled surface of each side, what was told about the part."""

    job: Job
    sides: tuple[Side, ...]
    reported: tuple[str, ...] = ()


def same_contacts(before: Job, after: Job) -> bool:
    """True when the contacts of a plan for the job ``before`` also serve the job ``after``, and its wall angles do."""
    if before.process not in ("SPIF", "DSIF"):
        return False
    same = all(getattr(before, name) == getattr(after, name) for name in KEPT_SECTIONS)
    # without a limit of the job, how steep the part may be is the material's to say
    same &= after.wall_angle_limit is not None or before.sheet.material == after.sheet.material
    return same and all(getattr(before.path, name) == getattr(after.path, name) for name in KEPT_PATH)


def reaches_further(base: PlanBase, job: Job) -> bool:
    """True when a forming tool of ``job`` has other contacts than the one before, so that they cannot be kept.

    A smaller ball gets into fillets and corners that were left by the one before. Where that one met wall and floor at
    once, its contact is on the wall: from there the smaller one does not come down to the floor. And levels of one
    scallop height follow from the radius.
    """
    for side in base.sides:
        before, after = (swapped(one, side.forming_tool).tool_1.ball_radius for one in (base.job, job))
        if after != before and job.path.spacing == "scallop":
            return True
        if after >= before:
            continue
        if side.left > UNREACHED_TOLERANCE:
            return True
        lowest = [side.tree.loops[feature.loops[-1]] for feature in side.tree.features if feature.loops]
        if any((before - after) * (1.0 - float(loop.normal[:, 2].min())) > UNREACHED_TOLERANCE for loop in lowest):
            return True
    return False


def with_tools(base: PlanBase, job: Job) -> tuple[Side, ...]:
    """The sides of a plan with tips for the tools of ``job``.

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL where a tip would cut into the part, with the place
    """
    sides = []
    for side in base.sides:
        before = swapped(base.job, side.forming_tool).tool_1.ball_radius
        after = swapped(job, side.forming_tool).tool_1.ball_radius
        loops = side.tree.loops
        if after != before:
            loops = tuple(_with_radius(loops, side.surface, before, after))
        sides.append(replace(side, tree=replace(side.tree, loops=loops)))
    return tuple(sides)


def _with_radius(loops: Sequence[TipLoop], surface: TargetSurface, before: float, after: float) -> list[TipLoop]:
    """All loops at once: tips of a ball of radius ``after`` m at the contacts of one of ``before`` m."""
    contact = np.vstack([loop.contact(before) for loop in loops])
    normal = np.vstack([loop.normal for loop in loops])
    centre = contact + after * normal
    moved = np.zeros(len(centre))
    for _ in range(6):
        height, _ = tip_surface.drop_tool(surface, centre[:, :2], after, near=contact[:, :2])
        cut = height + after - centre[:, 2]
        if cut.max() <= GOUGE_TOLERANCE / 2:
            break
        push = np.maximum(cut, 0.0) / np.maximum(normal[:, 2], 0.2)
        moved += push
        centre += push[:, None] * normal
    height, _ = tip_surface.drop_tool(surface, centre[:, :2], after)  # against the whole surface
    cut = np.maximum(height + after - centre[:, 2], moved)
    limit = np.where(moved > 0, FURTHEST, GOUGE_TOLERANCE)
    if (cut > limit).any():
        worst = int(np.argmax(cut - limit))
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"a ball of radius {after * 1e3:.2f} mm does not fit: it would cut {cut[worst] * 1e3:.2f} mm into the part",
            where=f"contact at {place_text(contact[worst])}",
            advice="use a smaller tool, or plan the part again with this tool to see what it leaves",
        )
    tip = centre - np.array([0.0, 0.0, after])
    ends = np.cumsum([len(loop.points) for loop in loops])[:-1]
    return [
        replace(loop, points=part[:, :2], height=part[:, 2], level=float(part[:, 2].mean()))
        for loop, part in zip(loops, np.split(tip, ends), strict=True)
    ]
