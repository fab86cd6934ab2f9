"""The support tool: where it goes, the force it is asked to press with, and what the job's ``force_rules`` come to.

It stands opposite the contact, or under the blank along the first contour (DSIF); where the backing plate leaves it no
room it waits below the sheet. Both tools are given point by point
at the same path parameter, so that they arrive together (Praveen 2020, 2.5). Rules without effect, and forces that
shed chips, are warned of.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.files.job import ForceRule, Job, JobFile, WallFacts, holds, ruled_forces
from isf_core.files.tooling import BackingPlateSpec, ToolSpec
from isf_core.geometry.loops import area_of
from isf_core.process import thickness_and_tips
from isf_core.process.support_window import support_window
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from isf_planner.forming.sides import Side, first_number
from isf_planner.part.mesh_checks import place_text
from isf_planner.paths.joined_paths import TipPath
from isf_planner.paths.loop_family import matched

CHORD = 1.0e-3
"""m of path before and after a point over which its turn is taken."""

WAITING_DEPTH = 5.0e-3
"""m between the lower face of the sheet and the tip of a lower tool that waits (assumed)."""

EVENLY = 3.0e-3
"""m of path of the forming tool, standard deviation, over which the place of a support tool under the blank is evened
out (assumed)."""

MINIMUM_TURN = 1.0e-3
"""rad over both chords; less is a straight line (radii above 2 m)."""


def opposite(contact: Array, normal: Array, gap: Array, tool: ToolSpec, away: Array, *, upper: bool) -> Array:
    """(N, 3) m, tips of a support tool whose rounding is ``gap`` (N,) m from the contacts along the normals.

    ``normal`` (N, 3) points to the forming tool, ``away`` (N, 3) horizontally from the forming tool to the wall; the
    axis of a flat tip is its flat radius further in that direction. ``upper``: the support tool is the upper one.
    """
    tip = thickness_and_tips.support_tip(contact, normal, tool.ball_radius, gap, upper=upper)
    return np.asarray(tip + tool.flat_radius * away)


def waiting(contours: Sequence[Contour], job: Job) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
    """``contours`` (DSIF) whose lower tool waits below the sheet until the backing plate leaves it room, and a warning
    that says so.

    Over a plate near the opening the first contours lie closer to its edge than the lower tool is wide: they are formed
    by the upper tool alone, held by the plate. The lower one stands still meanwhile, below the place where it is wanted
    first, deeper than the forming tool gets by then; it rises to it straight. So only contours of one feature from the
    first one on, which do not run on into the next one; what else meets the plate is left to
    :func:`isf_planner.checks.backing_plate.check_backing_plate`, as are contours none of which leaves room.
    """
    plate, tool, path = job.backing_plate, job.tool_2, job.path
    opposite = job.process == "DSIF" and path.support == "opposite"
    if plate is None or tool is None or not opposite or (path.style, path.transition) != ("contours", "step"):
        return tuple(contours), ()
    clear = next((k for k, contour in enumerate(contours) if _has_room(contour, plate, tool)), None)
    before = contours[:clear]
    first_ones = {(one.forming_tool, one.feature, one.stage) for one in contours[: (clear or 0) + 1]}
    if not clear or len(first_ones) > 1 or contours[0].forming_tool != 1:
        return tuple(contours), ()
    first = contours[clear]
    lowest = min(float(contour.forming_tip[:, 2].min()) for contour in contours[: clear + 1])
    place = np.array([*first.support_tip[0, :2], lowest - job.sheet.thickness - WAITING_DEPTH])
    waits = [
        replace(contour, support_tip=np.tile(place, (len(contour), 1)), support_force=np.empty(0)) for contour in before
    ]
    depth = 1e3 * abs(float(first.forming_tip[:, 2].min()))
    told = (
        f"the lower tool waits below the sheet until {contour_label(clear)}, {depth:.1f} mm deep: before, the backing "
        f"plate leaves its radius of {1e3 * tool.radius:.2f} mm no room"
    )
    return (*waits, *contours[clear:]), (told,)


def _has_room(contour: Contour, plate: BackingPlateSpec, tool: ToolSpec) -> bool:
    """Whether the support tool opposite ``contour`` is clear of the plate; not where it waits for a wider one."""
    tip = contour.support_tip
    return not contour.support_waits and bool(np.all(plate.inside(tip[:, 0], tip[:, 1]) >= tool.radius))


def along_first(first: Array, points: Array, *, closed: bool) -> Array:
    """(N, 3) m, for every forming tip (N, 3) the place opposite it on the closed line ``first`` (K, 3) of support tips.

    The first contour is formed with support opposite; later ones keep the tool there, under the undeformed blank
    beside the opening, where it acts as a backing plate that goes along. It goes along evenly: what is nearest leaps
    from chord to chord of the line, and across the corners of a part, which a tool cannot at the feed.
    """
    if (
        closed and area_of(points[:, :2]) * area_of(first[:, :2]) < 0.0
    ):  # every second contour of alternating ones runs the other way
        first = first[::-1]
    share = matched(points[:, :2], first[:, :2], closed=closed)
    count = len(share)
    turn = np.arange(count) / count if closed else np.linspace(0.0, share[-1] - share[0], count)
    spacing = float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean()) if count > 1 else EVENLY
    share = turn + gaussian_filter1d(share - turn, EVENLY / max(spacing, 1e-6), mode="wrap" if closed else "nearest")
    ring = np.vstack([first, first[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ring[:, :2], axis=0), axis=1))])
    place = np.mod(share, 1.0) * arc[-1]
    return np.column_stack([np.interp(place, arc, column) for column in ring.T])


def set_points(job: Job, path: TipPath, wall_angle: Array, base: float) -> Array:
    """(N,) N, force set-points of the contour along ``path``, or (0,) for position control; ``base`` m is the blank.

    None on the entry fillet and on walls too flat for a horizontal force (Ren 2018, 2.4.1), nor under the blank. A
    force that is chosen (``support_force: auto``) is the one for the flattest point of the contour; ``force_rules``
    replace it point by point.
    """
    control, flattest = job.control, float(wall_angle.min())
    force, depth = job.support_force_at(flattest), np.abs(path.points[:, 2] - base)
    forced = (
        force > 0
        and job.path.support == "opposite"
        and float(depth.min()) >= control.engage_depth - 1e-9
        and flattest >= control.engage_wall_angle
    )
    if not forced:
        return np.empty(0)
    return ruled_forces(control.force_rules, force, wall_facts(path, wall_angle, depth))


def wall_facts(path: TipPath, wall_angle: Array, depth: Array) -> WallFacts:
    """What rules for the support force ask about the points of ``path``; ``wall_angle`` (N,) rad, ``depth`` (N,) m."""
    away = path.outward()
    facing = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    x, y, _ = path.points.T
    step = np.hypot(np.diff(x), np.diff(y))
    along, angle = np.concatenate([[0.0], np.cumsum(step)]), facing
    if path.closed:  # once more before and after, so that the seam is a place like any other
        length = along[-1] + float(np.hypot(x[0] - x[-1], y[0] - y[-1]))
        turn = 2.0 * np.pi * np.round((facing[-1] - facing[0]) / (2.0 * np.pi))
        shifts = (-1, 0, 1)
        angle = np.concatenate([facing + k * turn for k in shifts])
        along = np.concatenate([along + k * length for k in shifts])
    here = along[len(x) : 2 * len(x)] if path.closed else along
    turned = np.abs(np.interp(here + CHORD, along, angle) - np.interp(here - CHORD, along, angle))
    with np.errstate(divide="ignore"):
        radius = np.where(turned > MINIMUM_TURN, 2.0 * CHORD / turned, np.inf)
    return WallFacts(facing, wall_angle, radius, depth, x, y)


def chosen_force(job: Job, contours: Sequence[Contour]) -> str:
    """What ``control.support_force: auto`` came to on ``contours`` and why, one line; empty when the force is given."""
    window = job.support_window
    if window is None:
        return ""
    forced = [contour for contour in contours if contour.force_controlled]
    if not forced:
        return f"support force auto: no contour under force control; {window.explanation(window.least_wall_angle)}"
    force = [float(contour.support_force.min()) for contour in forced]
    flattest = min(float(contour.wall_angle.min()) for contour in forced)
    return (
        f"support force auto: {min(force):.0f} to {max(force):.0f} N on {len(forced)} of {len(contours)} contours, "
        f"from {contour_label(forced[0].index)} on; {window.explanation(flattest)}"
    )


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
    return tuple(_remarks(rules, forced, facts, job_file))


def _remarks(
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
