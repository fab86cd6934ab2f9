"""Closed loops of the tool tip at a level: cut from the tip's surface, evenly spaced, with their contacts.

The loop at level z is the level line of the tip surface (:mod:`isf_planner.surface.tip_surface`): the border between
where the tip may be at z and where it would cut into the target. Rule for what lies exactly on a level (floors,
terraces, vertices of the mesh): it counts as below, so the loop runs around it. Numerically every level line is
taken 2 um above its level; the tip then moves at the level itself. Points stand at equal distances, and a loop starts
beside the start of the loop before.

A loop belongs to one feature of the part (:mod:`isf_planner.loops.sections`) and is either the border of a pocket or
goes around an island in it. Contact points are the expensive part of a plan: they, the normals and the curvatures
stay when a tool is changed (:mod:`isf_planner.replanning`); tips follow from them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import contourpy
import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job
from isf_core.types import Array, Mask

from isf_planner.part.mesh_checks import place_text
from isf_planner.surface import target_surface, tip_surface
from isf_planner.surface.target_surface import TargetSurface

GOUGE_TOLERANCE = 20e-6
"""m, how deep a planned tip may cut into the target."""

SETTLED_POINTS = 200
"""Fewest points with which a loop is brought to its level before it gets its final points."""

FLATTEST = 0.02
"""Smallest slope used to step towards the level line; on flatter ground the steps are limited anyway."""


def _empty() -> Array:
    return np.empty(0)


@dataclass(frozen=True)
class TipLoop:
    """A closed loop of the forming tool's tip at one level, N points, in frame ``sheet``.

    Attributes
    ----------
    level : m, z of the tip
    points : (N, 2) m, x and y of the tip; pockets counter-clockwise, islands clockwise (seen from above)
    normal : (N, 3) unit, from the contact to the ball's centre; points down for a lower forming tool
    height : (N,) m, z of the tip at every point when it is not ``level`` everywhere (after a change of tool), or (0,)
    curvature : (N, 2) 1/m, principal curvatures of the surface at the contacts, the larger first, positive where the
        surface bends towards the tool (concave), or (0,)
    feature : number of the feature (index into ``LoopTree.features``)
    parent : index of the loop above it in ``LoopTree.loops``, -1 at the top of a tree
    island : True when the loop goes around a part of the sheet that stands higher than the loop
    forming_tool : 1 (upper) or 2 (lower: the feature rises above the blank)
    """

    level: float
    points: Array
    normal: Array
    height: Array = field(default_factory=_empty)
    curvature: Array = field(default_factory=_empty)
    feature: int = 0
    parent: int = -1
    island: bool = False
    forming_tool: int = 1

    @property
    def start(self) -> Array:
        """(2,) m, first point."""
        return self.points[0]

    @property
    def tip(self) -> Array:
        """(N, 3) m."""
        z = self.height if len(self.height) else np.full(len(self.points), self.level)
        return np.column_stack([self.points, z])

    def raised(self, height: float) -> TipLoop:
        """The loop ``height`` m higher."""
        return replace(self, level=self.level + height, height=self.height + height) if height else self

    def contact(self, radius: float) -> Array:
        """(N, 3) m, contacts of the ball of ``radius`` m that the loop was made for."""
        up = radius if self.forming_tool == 1 else -radius
        return self.tip + np.array([0.0, 0.0, up]) - radius * self.normal


def tip_loop(surface: TargetSurface, rough: Array, level: float, job: Job, start: Array) -> TipLoop:
    """The loop at ``level`` (m) from its ``rough`` line (K, 2) m, started beside ``start`` (2,) m.

    Raises
    ------
    IsfError : CONTOUR_LOST when a tip would cut more than 20 um into the target, along its normal
    """
    radius, spacing = job.tool_1.ball_radius, job.path.point_spacing
    # the loop is settled with more points than it gets in the end, so that its chords follow it also in sharp turns
    points = resample(rough, min(spacing / 2, perimeter(rough) / SETTLED_POINTS), start)
    points, _, _ = settle(surface, points, level, radius, steps=3)
    points = with_equal_chords(points, spacing, start)
    points, contact, height = settle(surface, points, level, radius, steps=2)
    contact, cut = _cut(surface, points, level, radius, contact, height)
    cutting = cut > GOUGE_TOLERANCE
    if cutting.any():
        points = _drawn_back(surface, points, level, radius, cutting)
        contact, cut = _cut(surface, points, level, radius, contact, np.where(cutting, -np.inf, height))
    if cut.max() > GOUGE_TOLERANCE:
        worst = int(np.argmax(cut))
        place = np.append(points[worst], level)
        raise IsfError(
            ErrorCode.CONTOUR_LOST,
            f"no tip position found that cuts less than {cut[worst] * 1e6:.0f} um into the target",
            where=f"level {level * 1e3:.3f} mm at {place_text(place)}",
            advice="reduce path.point_spacing or the tool radius, or round the edges of the part",
        )
    normal = tip_surface.contact_normals(surface, points, contact, radius)
    width = target_surface.smoothing_width(surface.facet_width, radius)
    normal = target_surface.smooth_along(normal, spacing, width)
    bends = target_surface.principal(surface, points - radius * normal[:, :2], radius)
    return TipLoop(level, points, normal, curvature=bends)


def _cut(
    surface: TargetSurface, points: Array, level: float, radius: float, followed: Array, height: Array
) -> tuple[Array, Array]:
    """Contacts (N, 2) m of balls at ``points`` (N, 2) m, and how deep (N,) m they cut there along the normal.

    The whole ball is searched, since the contact ``followed`` by :func:`settle`, where the tip would be at ``height``,
    need not be the deepest any more. It stays where none is deeper: beside a floor, it is the wall's.
    """
    highest, contact = tip_surface.drop_tool(surface, points, radius)
    contact = np.where((highest > height + LIFT)[:, None], contact, followed)
    upright = np.sqrt(np.maximum(1.0 - ((points - contact) ** 2).sum(axis=1) / radius**2, 0.0))
    return contact, np.asarray((highest - level) * upright)


def settle(
    surface: TargetSurface, points: Array, level: float, radius: float, *, steps: int
) -> tuple[Array, Array, Array]:
    """Move points (N, 2) across the loop until the tip surface is at the level: points, contacts (N, 2), heights (N,).

    Newton's method along the outward normal of the loop; the slope of the tip surface is the slope at the contact.
    For a loop around an island the outward normal points to the island: its points run clockwise.
    """
    points = points.copy()
    outward = _outward(points)
    longest = 0.1 * radius
    height, contact = tip_surface.drop_tool(surface, points, radius)
    for _ in range(steps):
        arm = points - contact
        vertical = np.sqrt(np.maximum(radius**2 - (arm**2).sum(axis=1), (0.05 * radius) ** 2))
        slope = np.maximum(-(arm * outward).sum(axis=1) / vertical, FLATTEST)
        step = np.clip((level + LIFT - height) / slope, -longest, longest)
        points += step[:, None] * outward
        height, contact = tip_surface.drop_tool(surface, points, radius, near=contact + step[:, None] * outward)
    return points, contact, height


def _outward(points: Array) -> Array:
    """(N, 2) unit, across a loop."""
    tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    outward = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    return np.asarray(outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12))


def _drawn_back(surface: TargetSurface, points: Array, level: float, radius: float, cuts: Mask) -> Array:
    """Points (N, 2) m, of which those that ``cuts`` (N,) marks are moved inwards to where the ball is free.

    Where the contact jumps, from wall to wall at a steep rib or from floor to wall, Newton's method has lost it: the
    place is found by halving.
    """
    start, inward = points[cuts], -_outward(points)[cuts]

    def cutting(way: Array) -> Mask:
        height, _ = tip_surface.drop_tool(surface, start + way[:, None] * inward, radius)
        return height > level + LIFT

    near, far = np.zeros(len(start)), np.full(len(start), FIRST_WAY * radius)
    for _ in range(DOUBLINGS):
        still = cutting(far)
        if not still.any():
            break
        near, far = np.where(still, far, near), np.where(still, 2.0 * far, far)
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        still = cutting(middle)
        near, far = np.where(still, middle, near), np.where(still, far, middle)
    moved = points.copy()
    moved[cuts] += far[:, None] * inward
    return moved


def seen_from_above(loop: TipLoop, base: float = 0.0) -> TipLoop:
    """A loop planned on the mirrored surface (z to -z), over a flange at ``base`` m, in frame ``sheet``."""
    flip = np.array([1.0, 1.0, -1.0])
    turned = replace(
        loop, level=-loop.level, normal=loop.normal * flip, height=-loop.height, forming_tool=3 - loop.forming_tool
    )
    return turned.raised(base)


FIRST_WAY, DOUBLINGS, HALVINGS = 0.01, 5, 8
"""Way on which a point that cuts is drawn back at first, over the tool radius; how often it is doubled, then halved."""

LIFT = 2e-6
"""m, level lines are taken this much above the level of the tip; also the depth of cut this may cause."""

SMALLEST_STEP = 0.05
"""A last step smaller than this part of the incremental depth is added to the step before."""


def levels(depth: float, incremental_depth: float) -> Array:
    """(K,) m, z of the tip at every level: multiples of the incremental depth, the last one at the full depth."""
    count = max(1, int(np.ceil(depth / incremental_depth - SMALLEST_STEP)))
    return -np.append(incremental_depth * np.arange(1, count), depth)


def loops_at(x: Array, y: Array, height: Array, level: float) -> list[tuple[Array, bool]]:
    """All closed loops at ``level``: points (N, 2) m, first point not repeated, and whether it surrounds an island.

    Pockets (below the level inside) run counter-clockwise, islands in them (above the level inside) clockwise.

    Parameters
    ----------
    x, y, height : (nx,), (ny,), (ny, nx) m, a height field that is above the level along its border
    level : m

    Raises
    ------
    IsfError : CONTOUR_LOST when a loop is not closed
    """
    lines = contourpy.contour_generator(x, y, height, corner_mask=False).lines(level + LIFT)
    loops = []
    for line in lines:
        loop = np.asarray(line, dtype=np.float64)
        if len(loop) <= 3:
            continue
        if not np.array_equal(loop[0], loop[-1]):
            where = f"level {level * 1e3:.3f} mm at x = {loop[0, 0] * 1e3:.1f}, y = {loop[0, 1] * 1e3:.1f} mm"
            raise IsfError(
                ErrorCode.CONTOUR_LOST, "the contour is not closed", where=where, advice="add a plane flange"
            )
        loops.append(loop[:-1])
    islands = _surround_higher_ground(loops)
    return [
        (loop if (signed_area(loop) > 0) != island else loop[::-1], island)
        for loop, island in zip(loops, islands, strict=True)
    ]


def _surround_higher_ground(loops: list[Array]) -> list[bool]:
    """Outside all loops the ground is above the level, and every loop crossed inwards changes the side."""
    if len(loops) < 2:
        return [False] * len(loops)
    shapes = [shapely.Polygon(loop) for loop in loops]
    return [
        sum(other is not shape and shapely.contains_xy(other, *loop[0]) for other in shapes) % 2 == 1
        for loop, shape in zip(loops, shapes, strict=True)
    ]


def signed_area(loop: Array) -> float:
    """m^2, positive for a counter-clockwise closed loop (N, 2)."""
    following = np.roll(loop, -1, axis=0)
    return float(0.5 * np.sum(loop[:, 0] * following[:, 1] - following[:, 0] * loop[:, 1]))


FEWEST_POINTS = 12
"""A loop gets at least this many points, however short it is."""


def perimeter(loop: Array) -> float:
    """m, length of a closed loop (N, 2)."""
    return _Ring.of(loop).length


def first_start(loop: Array) -> Array:
    """(2,) m, where the loop crosses the ray in +x direction from its centroid, the farthest such point."""
    centre = np.asarray(shapely.Polygon(loop).centroid.coords[0])
    following = np.roll(loop, -1, axis=0)
    below, above = loop[:, 1] <= centre[1], following[:, 1] <= centre[1]
    crossing = np.flatnonzero(below != above)
    a, b = loop[crossing], following[crossing]
    share = (centre[1] - a[:, 1]) / (b[:, 1] - a[:, 1])
    x = a[:, 0] + share * (b[:, 0] - a[:, 0])
    return np.array([x.max(), centre[1]])


def resample(loop: Array, spacing: float, start: Array) -> Array:
    """(M, 2) m, points at equal arc length near ``spacing`` on the closed loop (N, 2), the first nearest ``start``."""
    line = _Ring.of(loop)
    return line.at(line.nearest(start) + line.length * np.arange(line.count(spacing)) / line.count(spacing))


def with_equal_chords(loop: Array, spacing: float, start: Array) -> Array:
    """As :func:`resample`, with equal straight distances between the points also where the loop turns sharply."""
    line = _Ring.of(loop)
    count = line.count(spacing)
    begin = line.nearest(start)
    distance = line.length * np.arange(count + 1) / count
    for _ in range(4):
        chord = np.linalg.norm(np.diff(line.at(begin + distance), axis=0), axis=1)
        reached = np.concatenate([[0.0], np.cumsum(chord)])
        distance = np.interp(reached[-1] * np.arange(count + 1) / count, reached, distance)
    return line.at(begin + distance[:-1])


@dataclass(frozen=True)
class _Ring:
    """A closed loop by arc length: ``points`` (N + 1, 2) m with the first one repeated, at ``arc`` (N + 1,) m."""

    points: Array
    arc: Array

    @staticmethod
    def of(loop: Array) -> _Ring:
        points = np.vstack([loop, loop[:1]])
        chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return _Ring(points, np.concatenate([[0.0], np.cumsum(chord)]))

    @property
    def length(self) -> float:
        return float(self.arc[-1])

    def count(self, spacing: float) -> int:
        return max(FEWEST_POINTS, round(self.length / spacing))

    def at(self, distance: Array) -> Array:
        arc = np.mod(distance, self.length)
        return np.column_stack([np.interp(arc, self.arc, self.points[:, axis]) for axis in range(2)])

    def nearest(self, point: Array) -> float:
        return float(shapely.LinearRing(self.points).project(shapely.Point(point)))
