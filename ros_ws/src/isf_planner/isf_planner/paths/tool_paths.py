"""From the loops of a part to the contours the tools follow, in the order of forming.

Features are formed one after the other, parents before children, each from the flange away; both tools are lifted
between features. Within a feature the loops become separate contours, contours joined by ramps, or one spiral, in the
direction the job asks for. Thickness along them is predicted by the sine law, or by the overlap method section by
section.

A feature that rises above the blank, or from a floor, is formed by the lower tool, which touches the other face of the
sheet, one thickness below the given surface.

The last contour of a wall leaves the floor inside it standing up as a low dome (pillow). Passes in rings, one tool step
apart, press it down: inwards, then outwards, as often as ``path.floor_rounds`` says, so that what a scan shows after
one round is mended in the next. Only flat floors without anything in them get passes. Where a ring splits, as in a neck
of the floor, one part is passed over after the other.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from isf_core.contour import Contour, over_floor, passes_over_floors, with_floor_passes
from isf_core.files.job import Job, JobFile, floor_rounds, floor_step
from isf_core.process import thickness_and_tips
from isf_core.types import Array
from scipy.spatial import KDTree

from isf_planner.forming.sides import UPSIDE_DOWN, Side, first_number, swapped
from isf_planner.loops import tip_loops
from isf_planner.loops.tip_loops import GOUGE_TOLERANCE, TipLoop, signed_area
from isf_planner.part.mesh_checks import place_text
from isf_planner.paths import contour_making, joined_paths
from isf_planner.paths.contour_making import contour_of, path_of
from isf_planner.paths.joined_paths import TipPath
from isf_planner.paths.loop_family import family
from isf_planner.surface import tip_surface
from isf_planner.surface.target_surface import TargetSurface


def make_contours(
    sides: Sequence[Side], job_file: JobFile, plan_id: str, *, preform: bool = False
) -> tuple[Contour, ...]:
    """Contours of all loops, upper tool first.

    Parameters
    ----------
    sides : loops, features and sampled target as the forming tool of each side sees them
    job_file : the job with its rig and material
    plan_id : of the plan
    preform : the part is formed from this shape in a further stage

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
    step = floor_step(job, preform=preform)
    walls = [len(paths) for paths in groups]
    for (side, feature, *_), paths in zip(chains, groups, strict=True):
        if not feature.island and not side.tree.children(feature.number):
            over = floor_paths(side.surface, paths[-1], swapped(job, side.forming_tool), step)
            paths += [_staggered(path, k * job.path.stagger) for k, path in enumerate(over, 1)]
    count = sum(len(paths) for paths in groups)
    contours: list[Contour] = []
    joins: list[bool] = []
    for (side, _, number, chain), paths, wall in zip(chains, groups, walls, strict=True):
        # the floor was pushed down as it is, without getting thinner: the sections say nothing about it
        over_it: list[Array | None] = [None] * (len(paths) - wall)
        formed = along(chain, paths[:wall], swapped(job, side.forming_tool)) + over_it
        first: Array | None = None
        for k, (path, thickness) in enumerate(zip(paths, formed, strict=True)):
            seen = replace(in_sheet(path, side), feature=number)
            contour = contour_of(
                seen, job, plan_id, len(contours), count, formed=thickness, first=first, base=side.base
            )
            if job.path.support == "on_blank" and contour.has_support and first is None:
                first = contour.support_tip
            contours.append(replace(contour, retract=k == 0 and bool(contours)))
            joins.append(path.joins)
    return tuple(contour_making.with_speed(with_lifts(contours), joins, job.path.acceleration))


def feature_paths(chain: Sequence[TipLoop], side: Side, job: Job) -> list[TipPath]:
    """Paths of one feature's loops in the style and sense of travel the job asks for, as the forming tool sees them."""
    options = job.path
    radius, spacing = swapped(job, side.forming_tool).tool_1.ball_radius, options.point_spacing
    paths = [
        directed(path_of(loop), options.direction, k, clockwise=signed_area(loop.points) < 0)
        for k, loop in enumerate(chain)
    ]
    if len(chain) < 2 or (options.style == "contours" and options.transition == "step"):
        return [_staggered(path, k * options.stagger) for k, path in enumerate(paths)]
    if options.style == "spiral":
        return joined_paths.spiral(side.surface, paths, radius, spacing)
    return joined_paths.ramps(side.surface, paths, options.ramp_length, radius, spacing)


def directed(path: TipPath, direction: str, number: int, *, clockwise: bool) -> TipPath:
    """A path that runs ``clockwise`` or not, in the sense of travel asked for."""
    wanted = direction == "cw" or (direction == "alternating" and number % 2 == 1)
    return path if clockwise == wanted else path.turned()


def _staggered(path: TipPath, distance: float) -> TipPath:
    """A closed path started ``distance`` m further along."""
    length = float(np.linalg.norm(np.roll(path.points, -1, axis=0) - path.points, axis=1).sum())
    shift = round(np.mod(distance, length) / length * len(path.points))
    return replace(path, points=np.roll(path.points, -shift, axis=0), normal=np.roll(path.normal, -shift, axis=0))


def in_sheet(path: TipPath, side: Side) -> TipPath:
    """A path planned in the view of the side's forming tool, in frame ``sheet``."""
    normal = path.normal * UPSIDE_DOWN if side.forming_tool == 2 else path.normal
    return replace(path, points=side.in_sheet(path.points), normal=normal, forming_tool=side.forming_tool)


FLAT_ROOM = 1.05
"""Radii of the flat of a tip that a ring over the floor is wide at least: the chords of its corners cut into one."""

SMALLEST = 0.5
"""Floor steps: radius of the circle as large as the smallest ring."""


def floor_paths(surface: TargetSurface, wall: TipPath, job: Job, step: float | None) -> list[TipPath]:
    """Rings over the floor inside the last path of a feature, in the order of forming; none where it is not flat.

    Inwards every ring is followed by all that lie in it before its neighbours are, outwards it follows them.

    Parameters
    ----------
    surface : the sampled target as the forming tool sees it ; wall : the last path, as the tool sees it
    job : with the forming tool as tool_1
    step : m, distance of the rings; None: none are wanted
    """
    if step is None:
        return []
    level = float(wall.points[:, 2].min())  # where a ramp ends
    shape = shapely.Polygon(wall.points[:, :2])
    flat = FLAT_ROOM * job.tool_1.flat_radius
    shapes = [[shape]]
    while shapes[-1]:
        inside = shape.buffer(-len(shapes) * step - flat)
        inside = inside.buffer(flat) if flat > 0.0 else inside  # nowhere narrower than the flat of the tip
        shapes.append([part for part in _polygons(inside) if part.area >= np.pi * (SMALLEST * step) ** 2])
    inner = _inner(shapes)
    passes: list[TipPath] = []
    splits = any(len(parts) > 1 for parts in shapes)
    near = wall.points[0, :2]
    waiting = [(place, near) for place in inner.get((0, 0), [])[::-1]]
    while waiting:
        (number, part), near = waiting.pop()
        passes.append(_ring(shapes[number][part], level, wall, near, job.path.point_spacing))
        if splits:  # behind a neck the start of the wall is no guide
            near = passes[-1].points[0, :2]
        waiting += [(place, near) for place in inner.get((number, part), [])[::-1]]
    if not all(_flat(surface, path, level, job.tool_1.ball_radius) for path in passes):
        return []
    return [path for turn in range(floor_rounds(job)) for path in (passes if turn % 2 == 0 else passes[::-1])]


def with_lifts(contours: Sequence[Contour]) -> list[Contour]:
    """``contours`` of one stage, the tools lifted before a pass over a floor that straight on is reached only through
    its wall; ``floor_passes`` is set."""
    contours = with_floor_passes(contours)
    if not any(contour.floor_passes for contour in contours):
        return list(contours)
    found, wall = list(contours[:1]), contours[0]
    room: shapely.Geometry | None = None
    for before, contour in itertools.pairwise(contours):
        if not over_floor(contour, before):
            wall, room = contour, None
        else:
            room = room or shapely.Polygon(wall.forming_tip[:, :2]).buffer(GOUGE_TOLERANCE)
            way = before.forming_tip[0 if before.closed else -1], contour.forming_tip[0]
            clear = room.covers(shapely.LineString([tip[:2] for tip in way]))
            contour = replace(contour, retract=contour.retract or not clear)
        found.append(contour)
    return found


def left_out(contours: Sequence[Contour], job: Job) -> tuple[str, ...]:
    """Warning when passes are asked for and no floor gets any."""
    step = job.path.floor_step
    if isinstance(step, str) or passes_over_floors(contours):
        return ()
    return (
        f"path.floor_step {1e3 * step:g} mm: no floor is passed over; it has to be flat, empty and more "
        "than one step wide inside the last contour",
    )


def _ring(shape: shapely.Polygon, level: float, wall: TipPath, near: Array, spacing: float) -> TipPath:
    """The outline of ``shape`` at ``level`` m, from the place next to ``near`` (2,) m on, in the sense of ``wall``."""
    line = np.asarray(shapely.geometry.polygon.orient(shape).exterior.coords)[:-1]
    points = tip_loops.with_equal_chords(line, spacing, near)
    tips = np.column_stack([points, np.full(len(points), level)])
    ring = replace(wall, points=tips, normal=np.tile([0.0, 0.0, 1.0], (len(tips), 1)), joins=False, closed=True)
    ring = replace(ring, wall_right=True)
    return ring if wall.wall_right else ring.turned()


def _inner(levels: Sequence[Sequence[shapely.Polygon]]) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """For a part of a level, both by their number, those of the next level that lie in it."""
    inner: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for k, (outer, parts) in enumerate(itertools.pairwise(levels)):
        for number, part in enumerate(parts):
            place = part.representative_point()
            around = min(range(len(outer)), key=lambda one: outer[one].distance(place))
            inner.setdefault((k, around), []).append((k + 1, number))
    return inner


def _polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    parts = shapely.get_parts(shape)
    return [part for part in parts if isinstance(part, shapely.Polygon) and not part.is_empty]


def _flat(surface: TargetSurface, path: TipPath, level: float, radius: float) -> bool:
    height, _ = tip_surface.drop_tool(surface, path.points[:, :2], radius)
    return bool(np.abs(height - level).max() <= GOUGE_TOLERANCE)


SECTIONS = 16
"""Vertical sections around a feature in which the overlap method is run."""


def along(chain: Sequence[TipLoop], paths: Sequence[TipPath], job: Job) -> list[Array | None]:
    """Thickness (N,) m of every path; None where the sine law of its own wall angle holds.

    ``job`` with the forming tool as tool_1, loops and paths as that tool sees them.
    """
    if job.path.thickness == "sine_law" or not sectioned(chain):
        return [None] * len(paths)
    points, formed = by_overlap(chain, job.tool_1.ball_radius, job.sheet.thickness)
    tree = KDTree(points)
    result: list[Array | None] = []
    for path in paths:
        distance, nearest = tree.query(path.points, k=4)
        weight = 1.0 / np.maximum(distance, 1e-6) ** 2
        result.append(np.asarray((formed[nearest] * weight).sum(axis=1) / weight.sum(axis=1)))
    return result


def sectioned(chain: Sequence[TipLoop]) -> bool:
    """Whether the overlap method says anything about a feature: passes follow each other inwards from an opening."""
    return len(chain) >= 3 and not chain[0].island


def left_to_sine_law(sides: Sequence[Side], job: Job) -> tuple[str, ...]:
    """Warning for the features that the overlap method leaves to the sine law, with their place."""
    if job.path.thickness == "sine_law":
        return ()
    chains = [(side, [side.tree.loops[k] for k in feature.loops]) for side in sides for feature in side.tree.features]
    left = [(side, chain[0]) for side, chain in chains if chain and not sectioned(chain)]
    if not left:
        return ()
    place = left[0][0].in_sheet(left[0][1].tip.mean(axis=0))
    return (
        f"thickness overlap: at {place_text(place)} and {len(left) - 1} more features the passes "
        f"do not follow each other inwards (an island, or fewer than three contours): sine law there",
    )


def by_overlap(chain: Sequence[TipLoop], radius: float, initial: float) -> tuple[Array, Array]:
    """Tips (K * M, 3) m of K loops at M phases around, and the thickness (K * M,) m at their contacts."""
    tips = family([loop.tip for loop in chain], 1e-3).points
    contacts, angles = [], []
    for loop, row in zip(chain, tips, strict=True):
        nearest = KDTree(loop.tip).query(row)[1]
        contacts.append(row + np.array([0.0, 0.0, radius]) - radius * loop.normal[nearest])
        angles.append(np.arccos(np.clip(np.abs(loop.normal[nearest, 2]), 0.0, 1.0)))
    contact, angle = np.array(contacts), np.array(angles)
    count = tips.shape[1]
    columns = np.unique(np.linspace(0, count, SECTIONS, endpoint=False).astype(np.int64))
    formed = np.empty((len(chain), len(columns)))
    for s, column in enumerate(columns):
        step = np.linalg.norm(np.diff(contact[:, column, :2], axis=0), axis=1)
        x = np.concatenate([[0.0], np.cumsum(step)])
        z = -np.maximum.accumulate(np.abs(contact[:, column, 2]))
        formed[:, s] = thickness_and_tips.overlap(x, z, angle[:, column], radius, initial)
    around = np.arange(count)
    everywhere = np.array([np.interp(around, columns, row, period=count) for row in formed])
    return tips.reshape(-1, 3), everywhere.ravel()
