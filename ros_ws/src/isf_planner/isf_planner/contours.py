"""From a level to one contour: the tip loop settled on the tip surface, contacts, normals, thickness, support tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core import thickness, tip_geometry
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner import resampling, slicing, surface_normals, tip_surface
from isf_planner.mesh_checks import place_text
from isf_planner.target_surface import TargetSurface

Array = NDArray[np.float64]

GOUGE_TOLERANCE = 20e-6
"""m, how deep a planned tip may cut into the target."""

SETTLED_POINTS = 200
"""Fewest points with which a loop is brought to its level before it gets its final points."""

FLATTEST = 0.02
"""Smallest slope used to step towards the level line; on flatter ground the steps are limited anyway."""


@dataclass(frozen=True)
class TipLoop:
    """A closed loop of the tool tip at one level, N points.

    Attributes
    ----------
    level : m ; points : (N, 2) m, x and y of the tip ; normal : (N, 3) from the contact to the ball's centre
    """

    level: float
    points: Array
    normal: Array

    @property
    def start(self) -> Array:
        """(2,) m, first point."""
        return self.points[0]


def tip_loop(surface: TargetSurface, rough: Array, level: float, job: Job, start: Array) -> TipLoop:
    """The loop at ``level`` (m) from its ``rough`` line (K, 2) m, started beside ``start`` (2,) m.

    Raises
    ------
    IsfError : CONTOUR_LOST when a tip would cut more than 20 um into the target
    """
    radius, spacing = job.tool_1.radius, job.path.point_spacing
    # the loop is settled with more points than it gets in the end, so that its chords follow it also in sharp turns
    points = resampling.resample(rough, min(spacing / 2, resampling.perimeter(rough) / SETTLED_POINTS), start)
    points, _, _ = _settle(surface, points, level, radius, steps=3)
    points = resampling.with_equal_chords(points, spacing, start)
    points, contact, height = _settle(surface, points, level, radius, steps=2)
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
    return TipLoop(level, points, surface_normals.smooth_along(normal, spacing, radius))


def make_contour(loop: TipLoop, job: Job, plan_id: str, index: int, count: int) -> Contour:
    """Contour of a loop for the job's tools: sine-law thickness, support tip at squeeze factor times thickness."""
    radius = job.tool_1.radius
    tip = np.column_stack([loop.points, np.full(len(loop.points), loop.level)])
    contact = tip + np.array([0.0, 0.0, radius]) - radius * loop.normal
    wall_angle = np.arccos(np.clip(loop.normal[:, 2], -1.0, 1.0))
    formed = thickness.sine_law(job.sheet.thickness, wall_angle)
    support_tip, support_force = np.empty((0, 3)), np.empty(0)
    if job.process == "DSIF" and job.tool_2 is not None:
        support_tip = tip_geometry.support_tip(
            contact, loop.normal, job.tool_2.radius, job.path.squeeze_factor * formed
        )
        control = job.control
        deep = -loop.level >= control.engage_depth - 1e-9
        if control.support_force > 0 and deep and wall_angle.min() >= control.engage_wall_angle:
            support_force = np.full(len(tip), control.support_force)
    return Contour(
        plan_id=plan_id,
        index=index,
        count=count,
        process=job.process_type,
        feed=job.path.feed,
        contact=contact,
        normal=loop.normal,
        wall_angle=wall_angle,
        thickness=formed,
        forming_tip=tip_geometry.forming_tip(contact, loop.normal, radius),
        support_tip=support_tip,
        support_force=support_force,
    ).validate()


def _settle(
    surface: TargetSurface, points: Array, level: float, radius: float, *, steps: int
) -> tuple[Array, Array, Array]:
    """Move points (N, 2) across the loop until the tip surface is at the level: points, contacts (N, 2), heights (N,).

    Newton's method along the outward normal of the loop; the slope of the tip surface is the slope at the contact.
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
