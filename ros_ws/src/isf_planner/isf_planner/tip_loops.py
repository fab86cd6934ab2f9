"""Closed loops of the tool tip: what planning hands on to path making.

A loop stands at one level, belongs to one feature of the part (:mod:`isf_planner.feature_tree`) and is either the
border of a pocket or goes around an island in it. Contact points are the expensive part of a plan: they, the
normals and the curvatures stay when a tool is changed (:mod:`isf_planner.replanning`); tips follow from them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner import curvature, resampling, slicing, surface_normals, tip_surface
from isf_planner.mesh_checks import place_text
from isf_planner.target_surface import TargetSurface

Array = NDArray[np.float64]

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
    IsfError : CONTOUR_LOST when a tip would cut more than 20 um into the target
    """
    radius, spacing = job.tool_1.ball_radius, job.path.point_spacing
    # the loop is settled with more points than it gets in the end, so that its chords follow it also in sharp turns
    points = resampling.resample(rough, min(spacing / 2, resampling.perimeter(rough) / SETTLED_POINTS), start)
    points, _, _ = settle(surface, points, level, radius, steps=3)
    points = resampling.with_equal_chords(points, spacing, start)
    points, contact, height = settle(surface, points, level, radius, steps=2)
    cut = height - level
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
    width = surface_normals.smoothing_width(surface.facet_width, radius)
    normal = surface_normals.smooth_along(normal, spacing, width)
    bends = curvature.principal(surface, points - radius * normal[:, :2], radius)
    return TipLoop(level, points, normal, curvature=bends)


def settle(
    surface: TargetSurface, points: Array, level: float, radius: float, *, steps: int
) -> tuple[Array, Array, Array]:
    """Move points (N, 2) across the loop until the tip surface is at the level: points, contacts (N, 2), heights (N,).

    Newton's method along the outward normal of the loop; the slope of the tip surface is the slope at the contact.
    For a loop around an island the outward normal points to the island: its points run clockwise.
    """
    points = points.copy()
    tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    outward = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    longest = 0.1 * radius
    height, contact = tip_surface.drop_tool(surface, points, radius)
    for _ in range(steps):
        arm = points - contact
        vertical = np.sqrt(np.maximum(radius**2 - (arm**2).sum(axis=1), (0.05 * radius) ** 2))
        slope = np.maximum(-(arm * outward).sum(axis=1) / vertical, FLATTEST)
        step = np.clip((level + slicing.LIFT - height) / slope, -longest, longest)
        points += step[:, None] * outward
        height, contact = tip_surface.drop_tool(surface, points, radius, near=contact + step[:, None] * outward)
    return points, contact, height


def seen_from_above(loop: TipLoop, base: float = 0.0) -> TipLoop:
    """A loop planned on the mirrored surface (z to -z), over a flange at ``base`` m, in frame ``sheet``."""
    flip = np.array([1.0, 1.0, -1.0])
    turned = replace(
        loop, level=-loop.level, normal=loop.normal * flip, height=-loop.height, forming_tool=3 - loop.forming_tool
    )
    return turned.raised(base)
