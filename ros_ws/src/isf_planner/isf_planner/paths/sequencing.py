"""The order of partial tool paths, and where each pass starts (Behera 2015, Intelligent sequencing, rules 2 to 6).

Passes are sorted by depth over all pockets and islands of a side. A closed contour starts next to where the one above
it was closed, but not within a tool radius of a rib that runs down; the first one as far from ribs as it can. From
there the tool steps down to the next one. It is lifted clear, moves in the air and plunges instead where the next pass
is not on the same pocket, begins farther from the tool than its radius, where the straight way would cut into the
surface, or between two open passes, which are not one line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import Job, JobFile, floor_step
from isf_core.types import Array

from isf_planner.forming.sides import Side, first_number, swapped
from isf_planner.loops.sections import LoopTree
from isf_planner.loops.tip_loops import GOUGE_TOLERANCE
from isf_planner.part.mesh_checks import place_text
from isf_planner.paths import contour_making, tool_paths
from isf_planner.paths.contour_making import contour_of, path_of
from isf_planner.paths.joined_paths import TipPath
from isf_planner.paths.partial_paths import SAFE, PartialPaths, Pass
from isf_planner.surface import tip_surface
from isf_planner.surface.target_surface import TargetSurface

WAY_STEP = 0.05
"""Distance of the places at which a step down is looked at, over the tool radius."""

STOPPING = 0.3
"""m/s^2 (assumed) by which the tool slows down towards the ends of an open pass, so that it does not run past them."""


@dataclass(frozen=True)
class Piece:
    """A path in the order of forming, as the forming tool sees it; ``retract``: the tool is lifted clear before."""

    path: TipPath
    retract: bool


def make_contours(
    sides: Sequence[Side], job_file: JobFile, plan_id: str, *, preform: bool = False
) -> tuple[Contour, ...]:
    """Contours of the partial paths of all sides, in order, of a part or of the ``preform`` of one.

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL (flat tip), FEATURES_MIXED (no lower tool)
    """
    job = job_file.job
    pieces = [
        (side, piece, first_number(sides, index) + piece.path.feature)
        for index, side in enumerate(sides)
        for piece in sequenced(side, swapped(job, side.forming_tool), floor_step(job, preform=preform))
    ]
    contours: list[Contour] = []
    for side, piece, number in pieces:
        seen = replace(tool_paths.in_sheet(piece.path, side), feature=number)
        made = contour_of(seen, job, plan_id, len(contours), len(pieces), base=side.base)
        if not made.closed:
            limit = job.path.acceleration or STOPPING
            made = replace(made, speed=contour_making.speeds(made.forming_tip, False, made.feed, limit))
        contours.append(replace(made, retract=piece.retract and bool(contours)))
    contours = tool_paths.with_lifts(contours)
    return tuple(contour_making.with_speed(contours, [False] * len(contours), job.path.acceleration))


def sequenced(side: Side, job: Job, over_floor: float | None = None) -> list[Piece]:
    """All passes of a ``side`` in the order of forming; ``job`` with the forming tool as tool_1, ``over_floor`` m from
    pass to pass over a floor, None: there are none."""
    partial, tree = side.partial, side.tree
    assert partial is not None  # made with the loops of a job that asks for it
    radius = job.tool_1.ball_radius
    order = sorted(partial.passes, key=lambda one: -tree.loops[one.loop].level)
    place = {loop: k for feature in tree.features for k, loop in enumerate(feature.loops)}
    ends: dict[int, Array] = {}
    pieces: list[Piece] = []
    before = -1
    tool: Array | None = None
    for one in order:
        loop = tree.loops[one.loop]
        feature = tree.features[loop.feature]
        above = ends.get(loop.feature, ends.get(feature.parent))
        path = _path(one, side, partial, above, radius)
        path = tool_paths.directed(path, job.path.direction, place[one.loop], clockwise=loop.island)
        follows = before in (loop.feature, feature.parent)
        both_open = bool(pieces) and not (path.closed or pieces[-1].path.closed)
        retract = tool is None or not follows or both_open or not steps_down(side.surface, tool, path.points[0], radius)
        pieces.append(Piece(path, retract))
        if one.loop == feature.loops[-1] and one.closed and not loop.island and not tree.children(feature.number):
            pieces += [Piece(ring, False) for ring in tool_paths.floor_paths(side.surface, path, job, over_floor)]
        last = pieces[-1].path
        before = loop.feature
        tool = ends[loop.feature] = last.points[0 if last.closed else -1]
    return pieces


def _path(one: Pass, side: Side, partial: PartialPaths, above: Array | None, radius: float) -> TipPath:
    """The path of a pass, in the order of its loop; a closed one from a safe place on."""
    whole = path_of(side.tree.loops[one.loop])
    points = one.points
    if one.closed:
        points = np.roll(points, -safe_start(whole.points, partial.rib_distance[one.loop], above, SAFE * radius))
    return replace(whole, points=whole.points[points], normal=whole.normal[points], closed=one.closed)


def safe_start(points: Array, rib_distance: Array, above: Array | None, safe: float) -> int:
    """Index of the point of a closed line ``points`` (N, 3) m at which to start.

    Next to the place ``above`` (3,) m of all that are ``safe`` m from ribs; farthest from ribs where none is, and for
    the first line (None), there the first point of several as far.
    """
    farthest = rib_distance >= min(0.98 * float(rib_distance.max()), np.finfo(float).max)
    candidates = np.flatnonzero(rib_distance >= safe if above is not None else farthest)
    if len(candidates) == 0:
        candidates = np.flatnonzero(farthest)
    goal = points[0] if above is None else above
    return int(candidates[np.argmin(np.linalg.norm(points[candidates, :2] - goal[:2], axis=1))])


def steps_down(surface: TargetSurface, here: Array, start: Array, radius: float) -> bool:
    """Whether the tip may move straight from ``here`` (3,) m to ``start`` (3,) m.

    The way is no longer than the tool ``radius`` m, seen from above, and nowhere cuts into the ``surface``.
    """
    way = float(np.linalg.norm(start[:2] - here[:2]))
    if way > radius:
        return False
    share = np.linspace(0.0, 1.0, max(3, int(np.ceil(way / (WAY_STEP * radius)))))
    line = here + share[:, None] * (start - here)
    height, _ = tip_surface.drop_tool(surface, np.ascontiguousarray(line[:, :2]), radius)
    return bool((height - line[:, 2]).max() <= GOUGE_TOLERANCE)


def near_ribs(tree: LoopTree, partial: PartialPaths, radius: float) -> tuple[str, ...]:
    """Warning where a contour has no place that is safe to start at, for a ball of ``radius`` m."""
    close = [one.loop for one in partial.passes if one.closed and partial.rib_distance[one.loop].max() < SAFE * radius]
    if not close:
        return ()
    where = place_text(tree.loops[close[0]].tip[int(np.argmax(partial.rib_distance[close[0]]))])
    return (
        f"path.partial_paths: {len(close)} contours have no place a tool radius away from ribs to start at, the first "
        f"at {where}",
    )
