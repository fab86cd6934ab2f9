"""Where the support tool goes: opposite the contact, or under the blank along the first contour (DSIF).

Both tools are given point by point at the same path parameter, so that they arrive together (Praveen 2020, 2.5).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core import tip_geometry
from isf_core.contour import Contour, contour_label
from isf_core.force_rule import WallFacts, ruled_forces
from isf_core.job import Job
from isf_core.job_tooling import ToolSpec
from numpy.typing import NDArray

from isf_planner.joined_paths import TipPath
from isf_planner.loop_family import matched

Array = NDArray[np.float64]

CHORD = 1.0e-3
"""m of path before and after a point over which its turn is taken."""

LEAST_TURN = 1.0e-3
"""rad over both chords; less is a straight line (radii above 2 m)."""


def opposite(contact: Array, normal: Array, gap: Array, tool: ToolSpec, away: Array, *, upper: bool) -> Array:
    """(N, 3) m, tips of a support tool whose rounding is ``gap`` (N,) m from the contacts along the normals.

    ``normal`` (N, 3) points to the forming tool, ``away`` (N, 3) horizontally from the forming tool to the wall; the
    axis of a flat tip is its flat radius further in that direction. ``upper``: the support tool is the upper one.
    """
    tip = tip_geometry.support_tip(contact, normal, tool.ball_radius, gap, upper=upper)
    return np.asarray(tip + tool.flat_radius * away)


def along_first(first: Array, points: Array, *, closed: bool) -> Array:
    """(N, 3) m, for every forming tip (N, 3) the place opposite it on the closed line ``first`` (K, 3) of support tips.

    The first contour is formed with support opposite; later ones keep the tool there, under the undeformed blank
    beside the opening, where it acts as a backing plate that goes along.
    """
    share = matched(points[:, :2], first[:, :2], closed=closed)
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
        radius = np.where(turned > LEAST_TURN, 2.0 * CHORD / turned, np.inf)
    return WallFacts(facing, wall_angle, radius, depth, x, y)


def chosen_force(job: Job, contours: Sequence[Contour]) -> str:
    """What ``control.support_force: auto`` came to on ``contours`` and why, one line; empty when the force is given."""
    window = job.support_window
    if window is None:
        return ""
    forced = [contour for contour in contours if contour.force_controlled]
    if not forced:
        return f"support force auto: no contour under force control; {window.told(window.least_wall_angle)}"
    force = [float(contour.support_force.min()) for contour in forced]
    flattest = min(float(contour.wall_angle.min()) for contour in forced)
    return (
        f"support force auto: {min(force):.0f} to {max(force):.0f} N on {len(forced)} of {len(contours)} contours, "
        f"from {contour_label(forced[0].index)} on; {window.told(flattest)}"
    )
