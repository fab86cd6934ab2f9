"""A program as a plan: its engaged moves become contours, checked as those of the planner are.

Normals and wall angles come from the paths themselves: the tips of a ball lie on a surface parallel to the sheet, so a
triangulation of the tips, without the triangles that span the floor inside one loop, has the sheet's normals.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import shapely
from isf_core.contour import Contour, Process, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.rig import Rig
from isf_core.files.tooling import ToolSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.tool_axis import point_on_axis, tilt_of
from isf_core.process.thickness_and_tips import sine_law
from isf_core.types import Array, Indices, Mask
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError

from isf_planner.checks import backing_plate, part_checks
from isf_planner.checks.shank_checks import check_shank
from isf_planner.gcode.reader import RAPID, Finding, Program
from isf_planner.part.mesh_checks import place_text
from isf_planner.part_plan import Plan
from isf_planner.predict.predictions import with_predictions
from isf_planner.processes import plan_id
from isf_planner.surface import height_grid

CLOSED = 1e-6
"""m between a point and the first one of its contour, at which the loop is closed."""
ON_SHEET = 1e-6
"""m over the sheet up to which a tip is engaged."""
MOST_STARTS = 4
"""Points of a contour at which its loop may close."""
MAP_PITCH = 1e-3
"""m, of the target."""
LEVEL = 0.1e-3
"""m, up to which two contours are at one level: a pass over a part goes on downwards, or upwards, across it."""


@dataclass(frozen=True)
class _Piece:
    """Points ``index`` of the program that make one contour."""

    index: Indices
    closed: bool
    lifted: bool


def check_program(program: Program, rig: Rig) -> tuple[Finding, ...]:
    """Points out of the rig's travel or out of reach of its axes, and rapid moves in the sheet: the first of each line.

    How deep the sheet is formed where a rapid move goes is not known here, so below its plane one may only leave it:
    straight upwards.
    """
    travel = np.asarray(rig.limits.travel)
    findings = []
    placeless = program.two_tools & forming_points(program) & (np.arange(len(program)) < program.lower_from)
    for k in np.flatnonzero(placeless)[:1]:
        what = "the upper tool forms before U, V and W have told where the lower tool is"
        advice = "name U, V and W (absolute) before the first move into the sheet"
        findings.append(_finding(program, int(k), what, program.tips[k, :3], advice))
    for tips, tool in ((program.tips[:, :3], "upper"), (program.tips[:, 3:], "lower")):
        if tool == "lower" and not program.two_tools:
            continue
        outside = (np.abs(tips) > travel + 1e-9).any(axis=1)
        for k in _first_of_lines(program.line, outside):
            text = " x ".join(f"{1e3 * value:.0f}" for value in travel)
            findings.append(
                _finding(program, k, f"the {tool} tool leaves the travel of the rig (+-{text} mm)", tips[k])
            )
        number = 1 if tool == "upper" else 2
        kinematics, leans = rig.make_kinematics()[number - 1], number == 1 and program.tilted
        within = (
            kinematics.reachable(point_on_axis(tips, program.axis, program.ball), tilt_of(program.axis))
            if leans
            else kinematics.reachable(tips)
        )
        for k in _first_of_lines(program.line, ~within & ~outside):
            leaning = (program.axis[k], program.ball) if leans else None
            findings.append(_finding(program, k, part_checks.axis_reason(rig, tips[k], number, leaning), tips[k]))
        for k in _first_of_lines(program.line, _rapid_in_sheet(program, tips, 1.0 if tool == "upper" else -1.0)):
            what = f"a rapid move takes the {tool} tool through the sheet"
            advice = "lift it straight off the sheet plane first, and go down with feed (G1)"
            findings.append(_finding(program, k, what, tips[k], advice))
    return tuple(sorted(findings, key=lambda finding: finding.line))


def check_work_offsets(
    program: Program, rig: Rig, offsets: dict[int, tuple[float, float, float]]
) -> tuple[Finding, ...]:
    """Work coordinate systems in use whose origin lies out of the rig's travel, at the first line that uses them."""
    findings = []
    for system, line in program.systems.items():
        origin = np.asarray(offsets[system])
        if (np.abs(origin) > np.asarray(rig.limits.travel)).any():
            what = f"the origin of G{system} at {place_text(origin)} is out of the travel of the rig"
            advice = f"correct work_offsets.G{system} of the set-up"
            where = f"{program.name}:{line}"
            findings.append(Finding(line, IsfError(ErrorCode.PROGRAM_OUT_OF_REACH, what, where=where, advice=advice)))
    return tuple(findings)


def forming_points(program: Program) -> Mask:
    """(N,) points of moves with feed at or below the sheet plane."""
    return np.asarray(np.isfinite(program.speed) & (program.tips[:, 2] <= ON_SHEET))


def check_tools(program: Program, tips: Mapping[int, ToolSpec], other: ToolSpec) -> tuple[Finding, ...]:
    """The first line of each tool that forms with another tip than the first one that forms: a plan has one.

    Parameters
    ----------
    tips : by number of the tool ; other : of a tool that is not in it
    """
    index = np.flatnonzero(forming_points(program))
    numbers, first = np.unique(program.tool[index], return_index=True)
    in_turn = sorted(zip(first.tolist(), numbers.tolist(), strict=True))
    findings = []
    for at, number in in_turn[1:]:
        before, here = tips.get(in_turn[0][1], other), tips.get(number, other)
        if not _same_tip(before, here):
            what = f"tool {number} ({_tip_text(here)}) forms after one of {_tip_text(before)}"
            advice = "one program for each tip: contacts, forces and the simulated tool are of one"
            findings.append(_finding(program, int(index[at]), what, program.tips[index[at], :3], advice))
    return tuple(findings)


def check_job_tool(program: Program, tips: Mapping[int, ToolSpec], own: ToolSpec) -> tuple[Finding, ...]:
    """The first line at which a tool forms whose tip, of those ``tips`` by number, is not that of the job, ``own``."""
    for k in np.flatnonzero(forming_points(program))[:1]:
        here = tips.get(int(program.tool[k]), own)
        if not _same_tip(here, own):
            what = (
                f"tool {program.tool[k]} of the set-up ({_tip_text(here)}) is not tool_1 of the job ({_tip_text(own)})"
            )
            advice = "correct the job, or the tools of the set-up: contacts and forces are those of the job's tip"
            return (_finding(program, int(k), what, program.tips[k, :3], advice),)
    return ()


def _same_tip(one: ToolSpec, other: ToolSpec) -> bool:
    same = math.isclose(one.radius, other.radius, rel_tol=1e-6)
    return same and math.isclose(one.ball_radius, other.ball_radius, rel_tol=1e-6)


def _tip_text(tool: ToolSpec) -> str:
    flat = "" if tool.corner_radius is None else f", flat with an edge of {1e3 * tool.corner_radius:g} mm"
    return f"{1e3 * tool.radius:g} mm radius{flat}"


def _rapid_in_sheet(program: Program, tips: Array, up: float) -> Mask:
    """(N,) points of rapid moves beyond the sheet plane; ``up`` is 1 for the upper tool, -1 for the lower one."""
    away = up * np.diff(tips[:, 2], prepend=np.inf * up)  # the way to the first point is not known
    across = np.linalg.norm(np.diff(tips[:, :2], axis=0, prepend=tips[:1, :2]), axis=1)
    leaves = (away >= 0.0) & (across <= CLOSED)
    return np.asarray((program.speed == RAPID) & (up * tips[:, 2] < -ON_SHEET) & ~leaves)


def _first_of_lines(line: Indices, bad: NDArray[np.bool_]) -> list[int]:
    index = np.nonzero(bad)[0]
    _, first = np.unique(line[index], return_index=True)
    return [int(k) for k in index[first][:1000]]


def _finding(
    program: Program, k: int, what: str, tip: Array, advice: str = "move the work offset, or correct the program"
) -> Finding:
    line = int(program.line[k])
    error = IsfError(
        ErrorCode.PROGRAM_OUT_OF_REACH,
        what,
        where=f"{program.name}:{line} at {place_text(tip)}",
        advice=advice,
    )
    return Finding(line, error)


def program_plan(program: Program, job_file: JobFile) -> Plan:
    """Plan of ``program`` for sheet, tools and rig of ``job_file``; its part is not used.

    The upper tool forms. Two tools make a DSIF plan with position control: a program holds no forces. The target is the
    surface of the contacts, flat inside the last loops and 0 outside the first.

    Raises
    ------
    IsfError : PROGRAM_UNREADABLE when no move presses into the sheet; PROCESS_NOT_SUPPORTED for a program with other
        tools than the job; PART_DOES_NOT_FIT as for every plan
    """
    job, rig = job_file.job, job_file.rig
    if program.tilted and job.tool_1.flat_radius > 0.0:
        raise IsfError(
            ErrorCode.PROCESS_NOT_SUPPORTED,
            "the program tilts a tool with a flat tip: it would stand on its edge",
            where=program.name,
            advice="use a hemisphere (no tool_1.corner_radius)",
        )
    if program.two_tools and job.tool_2 is None:
        raise IsfError(
            ErrorCode.PROCESS_NOT_SUPPORTED,
            "the program moves a lower tool (U, V, W), the job has none",
            where=program.name,
            advice="give a job with tool_2",
        )
    below = program.two_tools & np.isfinite(program.speed) & (program.tips[:, [2, 5]] > ON_SHEET).all(axis=1)
    if below.any():
        raise IsfError(
            ErrorCode.PROCESS_NOT_SUPPORTED,
            "the lower tool forms here, over the sheet plane",
            where=f"{program.name}:{program.line[int(np.argmax(below))]}",
            advice="a program forms with the upper tool; plan a part formed from both sides from its surface",
        )
    pieces, short = _pieces(program)
    if not pieces and short:
        raise IsfError(
            ErrorCode.PROGRAM_UNREADABLE,
            "what goes below the sheet (z = 0) has fewer than three points: a poke or a groove shorter than the step",
            where=f"{program.name}:{short[0]}",
            advice="a smaller --step, or a longer path in the sheet",
        )
    if not pieces:
        raise IsfError(
            ErrorCode.PROGRAM_UNREADABLE,
            "no move with feed goes below the sheet (z = 0)",
            where=program.name,
            advice="check unit and work offset; the sheet lies at z = 0 of frame sheet",
        )
    tips = np.concatenate([program.tips[piece.index, :3] for piece in pieces])
    owner = np.repeat(np.arange(len(pieces)), [len(piece.index) for piece in pieces])
    group = _surfaces(tips, owner)[owner]
    normal = np.empty_like(tips)
    for one in np.unique(group):
        normal[group == one] = surface_normals(tips[group == one], owner[group == one])
    contact = contact_points(tips, normal, job.tool_1)
    angle = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
    path = program.tips.tobytes() + program.speed.tobytes() + program.given.tobytes() + program.axis.tobytes()
    holds = holds_of(program)
    lifted = {number for number, hold in holds.items() if hold.lifted}
    path += np.array(sorted(lifted), dtype=np.int64).tobytes()
    name = plan_id(job_file, path)
    contours, at = [], 0
    for number, piece in enumerate(pieces):
        here = slice(at, at + len(piece.index))
        at += len(piece.index)
        speed = program.speed[piece.index]
        speed = np.where(np.isfinite(speed), speed, job.path.feed)
        contours.append(
            Contour(
                plan_id=name,
                index=number,
                count=len(pieces),
                process=Process.DSIF if program.two_tools else Process.SPIF,
                feed=float(speed.max()),
                contact=contact[here],
                normal=normal[here],
                wall_angle=angle[here],
                thickness=sine_law(job.sheet.thickness, angle[here]),
                forming_tip=tips[here],
                support_tip=program.tips[piece.index, 3:] if program.two_tools else np.empty((0, 3)),
                speed=speed if float(np.ptp(speed)) > 0.0 else np.empty(0),
                forming_axis=program.axis[piece.index] if program.tilted else np.empty((0, 3)),
                closed=piece.closed,
                retract=piece.lifted,
                lift_after=number + 1 in lifted,
            ).validate()
        )
    filled, warnings = with_predictions(tuple(contours), job_file)  # a compensation would move the program's tips
    part_checks.check_machine(filled, job, rig)
    backing_plate.check_backing_plate(filled, job)
    target = _target(contact, group, rig.clamp.size)
    shank, near = check_shank(filled, target, job_file)
    mesh = height_grid.as_mesh(target)
    warnings = (*warnings, *near, *backing_plate.check_held(filled, mesh, job, rig))
    surface = mesh.vertices, mesh.faces
    if short:
        first = ", ".join(map(str, short[:5])) + (", ..." if len(short) > 5 else "")
        left = f"left out: {len(short)} move(s) into the sheet of fewer than three points, from line {first}"
        warnings = (left, *warnings)
    told = tuple(dict.fromkeys(warnings))
    return Plan(
        name,
        filled,
        target,
        surface,
        told,
        shank=shank,
        ball_radius=job.tool_1.ball_radius,
        hold_after=tuple(sorted({*job.path.hold_after, *holds})),
    )


@dataclass(frozen=True)
class Hold:
    """A program stop (M0) in ``line``; ``lifted``: the program has lifted the upper tool off the sheet before it."""

    line: int
    lifted: bool


def holds_of(program: Program) -> dict[int, Hold]:
    """Contours, counted from 1, after which a program stop waits, to the last stop there.

    A stop before the first contour and one after the last are left out: nothing is formed before, or after.
    """
    pieces, engaged = _pieces(program)[0], _engaged(program)
    first = np.array([piece.index[0] for piece in pieces])
    holds = {}
    for point, line in program.stops:
        number = int((first <= point).sum())
        if 0 < number < len(pieces):
            lifted = bool(point > pieces[number - 1].index[-1] and not engaged[point])
            holds[number] = Hold(line, lifted)
    return dict(sorted(holds.items()))


def lines_of(program: Program, plan: Plan) -> dict[str, tuple[int, int]]:
    """First and last line of every contour, by the label that people read."""
    return {
        contour_label(number): (int(program.line[piece.index[0]]), int(program.line[piece.index[-1]]))
        for number, piece in enumerate(_pieces(program)[0][: len(plan.contours)])
    }


def _pieces(program: Program) -> tuple[list[_Piece], list[int]]:
    """Engaged runs cut into closed loops, or into single turns where nothing closes.

    With them the lines at which runs begin that have too few points for a contour.
    """
    tips = program.tips
    down = tips[:, 2] <= ON_SHEET
    rapid = program.speed == RAPID
    engaged = _engaged(program)
    pieces: list[_Piece] = []
    short: list[int] = []
    lifted = True
    k, n = 0, len(tips)
    while k < n:
        if not engaged[k]:
            lifted = True
            k += 1
            continue
        begin = k
        while k < n and engaged[k]:
            k += 1
        run = np.arange(begin, k)
        if begin > 0 and rapid[begin - 1] and down[begin - 1]:
            run = np.concatenate([[begin - 1], run])
        kept = np.concatenate([[True], np.linalg.norm(np.diff(tips[run], axis=0), axis=1) > 1e-9])
        ends: Indices = run[:0]
        for part in _until_stops(run[kept], program):
            cuts = _cut(part, program, lifted, ends)
            ends = cuts[-1].index[:MOST_STARTS] if cuts and not cuts[-1].closed else run[:0]
            if not cuts:
                short.append(int(program.line[part[0]]))
            for piece in cuts:
                pieces.append(piece)
                lifted = False
    return pieces, short


def _engaged(program: Program) -> Mask:
    """(N,) points at which the upper tool forms: reached with feed at or below the sheet plane, of a plunge the end."""
    tips = program.tips
    down = tips[:, 2] <= ON_SHEET
    above = np.concatenate([[True], ~down[:-1]])  # the move to a point begins above the sheet
    level = np.concatenate([[np.inf], np.linalg.norm(np.diff(tips[:, :2], axis=0), axis=1)])
    return np.asarray(down & (program.speed != RAPID) & (program.given | ~above | (level > CLOSED)))


def _until_stops(run: Indices, program: Program) -> list[Indices]:
    """``run`` cut after the points at which the program stops, where three points or more are left on both sides."""
    ends = sorted({int(np.searchsorted(run, point, side="right")) for point, _ in program.stops})
    parts, start = [], 0
    for end in ends:
        if end - start >= 3 and len(run) - end >= 3:
            parts.append(run[start:end])
            start = end
    return [*parts, run[start:]]


def _cut(run: Indices, program: Program, lifted: bool, ends: Indices) -> list[_Piece]:
    """The contours of one run without lifting, each of three points or more, cut where a loop closes or a turn ends.

    A loop that closes on the first point given is a closed contour, and points on the way to it from the loop before
    are left out: that way is the controller's. One that closes on a later point (the loop before ran on past its seam)
    stays open and keeps all its points. ``ends``: points at which the rest of a loop that a stop has cut ends.
    """
    both = program.tips[run].tolist()
    given = program.given[run].tolist()
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(program.tips[run, :3], axis=0), axis=1))]).tolist()
    cuts: list[_Piece] = []

    def cut(index: Indices, *, closed: bool) -> None:
        cuts.append(_Piece(index, closed, lifted and not cuts))

    start, turned, heading = 0, 0.0, None
    starts: list[int] = []  # points at which the loop may close
    closes = -1  # point at which it is known to close
    seams = program.tips[ends].tolist()
    for k, here in enumerate(both):
        if k - start >= 2 and any(math.dist(here, seam) <= CLOSED for seam in seams):
            cut(run[start : k + 1], closed=False)
            start, starts, turned, heading, seams = k + 1, [], 0.0, None, []
            continue
        closing = next((one for one in starts if k - one >= 3 and math.dist(here, both[one]) <= CLOSED), None)
        if closing is not None:
            first, seams = closing == starts[0], []
            cut(run[closing:k] if first else run[start : k + 1], closed=first)
            start, starts, turned, heading = k + 1, [], 0.0, None
            continue
        if (given[k] or k == start) and len(starts) < MOST_STARTS:
            starts = [k] if starts == [start] and not given[start] else [*starts, k]
        if k == start:
            continue
        dx, dy = here[0] - both[k - 1][0], here[1] - both[k - 1][1]
        if math.hypot(dx, dy) > CLOSED:
            now = math.atan2(dy, dx)
            turned += math.remainder(now - heading, math.tau) if heading is not None else 0.0
            heading = now
        if abs(turned) > math.tau and k - start >= 3 and k > closes:
            # the last corner may turn past 2 pi by rounding, an edge before the loop closes: look as far again as it is
            ahead = range(k, bisect_right(along, 2.0 * along[k] - along[start]))
            closes = next((j for j in ahead if any(math.dist(both[j], both[one]) <= CLOSED for one in starts)), -1)
            if closes < 0:
                cut(run[start:k], closed=False)
                seams = []
                start, starts = k, [k]
            turned = 0.0
    left = run[start:]
    if len(left) >= 3:
        cut(left, closed=False)
    elif len(left) and cuts:  # too short for a contour of its own
        last = cuts.pop()
        seam = last.index[:1] if last.closed else last.index[:0]
        cuts.append(_Piece(np.concatenate([last.index, seam, left]), False, last.lifted))
    return cuts


def surface_normals(tips: Array, owner: Indices) -> Array:
    """(N, 3) unit, upward normals of the surface through ``tips`` (N, 3) m; ``owner`` (N,) is the contour of each.

    Triangles with all corners in one contour span a floor, or cut a corner, and count only where no others are.
    """
    upright = np.tile([0.0, 0.0, 1.0], (len(tips), 1))
    try:
        mesh = Delaunay(tips[:, :2])
    except (QhullError, ValueError):
        return upright  # all on one line, or fewer than three
    corners = mesh.simplices.astype(np.int64)
    sides = tips[corners]
    normal = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    area = np.linalg.norm(normal, axis=1)
    flat = area > 0.0
    corners, sides, normal = corners[flat], sides[flat], normal[flat] / area[flat, None]
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0)
    between = np.ptp(owner[corners], axis=1) > 0
    total = np.zeros((2, len(tips), 3))
    for k in range(3):
        a, b = sides[:, (k + 1) % 3] - sides[:, k], sides[:, (k + 2) % 3] - sides[:, k]
        lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        weight = np.arccos(np.clip((a * b).sum(axis=1) / np.maximum(lengths, 1e-30), -1.0, 1.0))[:, None]
        np.add.at(total[0], corners[between, k], (weight * normal)[between])
        np.add.at(total[1], corners[:, k], weight * normal)
    chosen = np.where((np.linalg.norm(total[0], axis=1) > 1e-9)[:, None], total[0], total[1])
    size = np.linalg.norm(chosen, axis=1)
    upright[size > 1e-9] = chosen[size > 1e-9] / size[size > 1e-9, None]
    upright[mesh.coplanar[:, 0]] = upright[mesh.coplanar[:, 2]]  # over or under another point
    return upright


def contact_points(tips: Array, normal: Array, tool: ToolSpec) -> Array:
    """(N, 3) m, where an upper tool with its ``tips`` (N, 3) m touches a sheet with the ``normal`` (N, 3)."""
    ball = tool.ball_radius
    contact = tips + ball * (np.array([0.0, 0.0, 1.0]) - normal)
    across = np.linalg.norm(normal[:, :2], axis=1)
    steep = across > 1e-6
    contact[steep, :2] -= tool.flat_radius * normal[steep, :2] / across[steep, None]
    return contact


def _features(tips: Array, owner: Indices) -> Indices:
    """(P,) number of the feature of each of the P contours: contours whose outlines overlap form one."""
    bounds = np.flatnonzero(np.diff(owner)) + 1
    hulls = [shapely.MultiPoint(part[:, :2]).convex_hull.buffer(1e-5) for part in np.split(tips, bounds)]
    tree = shapely.STRtree(hulls)
    pairs = tree.query(hulls, predicate="intersects")
    links = coo_array((np.ones(pairs.shape[1]), (pairs[0], pairs[1])), shape=(len(hulls), len(hulls)))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def _surfaces(tips: Array, owner: Indices) -> Indices:
    """(P,) number of the surface of each of the P contours: of its feature, and of the pass over it.

    A pass goes down, or up (an inverse one, from full depth), and ends where the next contour goes the other way.
    """
    depth = np.bincount(owner, tips[:, 2]) / np.bincount(owner)
    newest: dict[int, tuple[int, float, int]] = {}  # pass, level reached and sense: down -1, up 1, 0 not known yet
    surface = np.empty(len(depth), dtype=np.int64)
    count = 0
    for k, (feature, z) in enumerate(zip(_features(tips, owner).tolist(), depth.tolist(), strict=True)):
        number, before, sense = newest.get(feature, (-1, z, 0))
        way = 0 if abs(z - before) <= LEVEL else (1 if z > before else -1)
        if number < 0 or way * sense < 0:
            number, count, sense = count, count + 1, 0
        else:
            sense = sense or way
        newest[feature] = number, z, sense
        surface[k] = number
    return surface


def _target(contact: Array, group: Indices, clamp: tuple[float, float]) -> HeightMap:
    half = [int(np.floor(side / 2 / MAP_PITCH + 1e-9)) for side in clamp]
    x, y = (MAP_PITCH * np.arange(-n, n + 1, dtype=np.float64) for n in half)
    gx, gy = np.meshgrid(x, y)
    z = np.zeros(gx.shape)
    for one in np.unique(group):
        part = contact[group == one]
        with suppress(QhullError, ValueError):  # a line has no inside
            z = np.minimum(z, LinearNDInterpolator(part[:, :2], part[:, 2], fill_value=0.0)(gx, gy))
    return HeightMap(x, y, z)
