"""What a job's ``force_rules`` come to on its contours: rules without effect, and forces that shed chips."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from isf_core.contour import Contour
from isf_core.force_rule import ForceRule, WallFacts, holds
from isf_core.job import JobFile
from isf_core.support_window import support_window
from numpy.typing import NDArray

from isf_planner.joined_paths import TipPath
from isf_planner.mesh_checks import place_text
from isf_planner.sides import Side, first_number
from isf_planner.support_tool import wall_facts

Array = NDArray[np.float64]


def rule_warnings(contours: Sequence[Contour], sides: Sequence[Side], job_file: JobFile) -> tuple[str, ...]:
    """Warnings of rules that decide nowhere, and of those whose force may shed chips, with the worst place.

    ``contours`` as they come from the job's paths, before their tips are compensated; ``sides`` of the last stage.
    """
    rules = job_file.job.control.force_rules
    if not rules:
        return ()
    forced = [contour for contour in contours if contour.force_controlled]
    if not forced:
        return ("force_rules: no contour is under force control, none of the rules has an effect",)
    base = {
        first_number(sides, number) + k: side.base
        for number, side in enumerate(sides)
        for k in range(len(side.tree.features))
    }
    facts = [facts_of(contour, base.get(contour.feature, 0.0), job_file.job.sheet.thickness) for contour in forced]
    return tuple(_told(rules, forced, facts, job_file))


def _told(
    rules: Sequence[ForceRule], forced: Sequence[Contour], facts: Sequence[WallFacts], job_file: JobFile
) -> Iterator[str]:
    where = [[holds(rule, item) for item in facts] for rule in rules]
    for number, (rule, mine) in enumerate(zip(rules, where, strict=True), start=1):
        name = f"force rule {number} ({rule.force:.0f} N)"
        if not any(points.any() for points in mine):
            yield f"{name} holds on no point of the {len(forced)} contours under force control"
            continue
        later = where[number:]
        decides = [
            points & ~np.any([other[k] for other in later], axis=0) if later else points
            for k, points in enumerate(mine)
        ]
        if not any(points.any() for points in decides):
            yield f"{name} has no effect: later rules hold wherever it does"
            continue
        yield from _chips(name, rule.force, forced, decides, job_file)


def _chips(
    name: str, force: float, forced: Sequence[Contour], decides: Sequence[NDArray[np.bool_]], job_file: JobFile
) -> Iterator[str]:
    """Warning where ``force`` is beyond the limit of chips, at the point of the flattest wall."""
    job, rig, material = job_file.job, job_file.rig, job_file.material
    if job.tool_2 is None:
        return
    radius = min(job.tool_1.ball_radius, job.tool_2.ball_radius)
    window = support_window(
        material.tensile_strength, radius, job.sheet.thickness, rig.contact_stiffness, rig.limits.offset
    )
    angle = np.concatenate([contour.wall_angle[points] for contour, points in zip(forced, decides, strict=True)])
    place = np.vstack([contour.forming_tip[points] for contour, points in zip(forced, decides, strict=True)])
    worst = int(np.argmin(angle))
    most = float(window.chips_at(angle[worst : worst + 1])[0])
    if force > most:
        yield (
            f"{name} at {place_text(place[worst])}: on a wall of {np.degrees(angle[worst]):.0f} deg {material.name} of "
            f"{1e3 * job.sheet.thickness:g} mm may shed chips under tools of {1e3 * radius:g} mm from {most:.0f} N on"
        )


def facts_of(contour: Contour, base: float, thickness: float) -> WallFacts:
    """What the set-points of ``contour`` were made from; ``base`` m is z of its flange, ``thickness`` m the sheet's."""
    tip = contour.forming_tip
    if contour.forming_tool == 2:  # the path is on the given surface, the tool on the other face
        tip = tip + np.array([0.0, 0.0, thickness])
    path = TipPath(tip, contour.normal, closed=contour.closed)
    into_wall = float((path.outward() * -contour.normal).sum())
    path = TipPath(tip, contour.normal, closed=contour.closed, wall_right=into_wall > 0.0)
    return wall_facts(path, contour.wall_angle, np.abs(tip[:, 2] - base))
