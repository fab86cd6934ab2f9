"""From a line of the forming tip to one contour: contacts, thickness, both tools, and the speed along it.

Flat tips have a rounded edge: the tool is the disc of the flat swept by the ball of the corner radius. So where the
ball may run at a level, the tool may run inside by the flat radius, and its contacts are those of the ball.

Speed follows from an acceleration limit: slow in corners and at both ends, the feed elsewhere. Half of the squared
limit is for the turn, half for speeding up and slowing down, so that both together keep it: v^2 <= a k^-1 / sqrt(2) in
a turn of curvature k, and v may change by a / sqrt(2) per second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job
from isf_core.process import thickness_and_tips
from isf_core.types import Array

from isf_planner.loops.tip_loops import TipLoop
from isf_planner.part.mesh_checks import place_text
from isf_planner.paths import support_tool
from isf_planner.paths.joined_paths import TipPath


def path_of(loop: TipLoop) -> TipPath:
    """The closed path of one loop."""
    return TipPath(loop.tip, loop.normal, True, loop.feature, loop.forming_tool)


def contour_of(
    path: TipPath,
    job: Job,
    plan_id: str,
    index: int,
    count: int,
    *,
    formed: Array | None = None,
    first: Array | None = None,
    base: float = 0.0,
) -> Contour:
    """Contour of a path for the job's tools.

    Parameters
    ----------
    path : tips of the ball that is the rounding of the forming tool's tip, on the given surface
    formed : (N,) m, predicted thickness; None: sine law
    first : (K, 3) m, line of support tips under the blank (``path.support`` on_blank); None: opposite the contact
    base : m, z of the flange of the feature: 0, or the floor it stands on

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL where a flat tip does not fit
    """
    upper = path.forming_tool == 1
    forming, other = (job.tool_1, job.tool_2) if upper else (job.tool_2, job.tool_1)
    if forming is None:
        raise IsfError(
            ErrorCode.FEATURES_MIXED,
            f"feature {path.feature} rises above the blank and has to be formed from below, where there is no tool",
            where="tool_2",
            advice="use process DSIF with a lower tool, or turn the part over",
        )
    ball = forming.ball_radius
    wall_angle = np.arccos(np.clip(np.abs(path.normal[:, 2]), 0.0, 1.0))
    if formed is None:
        formed = thickness_and_tips.sine_law(job.sheet.thickness, wall_angle)
    points = path.points
    if not upper:  # the other face of the sheet: under the sine law one blank's thickness straight below
        points = points - np.array([0.0, 0.0, job.sheet.thickness])
    centre = points + np.array([0.0, 0.0, ball if upper else -ball])
    contact = centre - ball * path.normal
    away = path.outward()
    support_tip, support_force = np.empty((0, 3)), np.empty(0)
    if job.process == "DSIF" and other is not None:
        if first is None:
            gap = job.path.squeeze_factor * formed
            support_tip = support_tool.opposite(contact, path.normal, gap, other, away, upper=not upper)
        else:
            support_tip = support_tool.along_first(first, points, closed=path.closed)
        support_force = support_tool.set_points(job, path, wall_angle, base)
    return Contour(
        plan_id=plan_id,
        index=index,
        count=count,
        process=job.process_type,
        feed=job.path.feed,
        contact=contact,
        normal=path.normal,
        wall_angle=wall_angle,
        thickness=formed,
        forming_tip=inset(points, away, forming.flat_radius, closed=path.closed),
        support_tip=support_tip,
        support_force=support_force,
        forming_tool=path.forming_tool,
        closed=path.closed,
        feature=path.feature,
    ).validate()


INSET_TOLERANCE = 20e-6
"""m, by which the flat may stand over on a closed loop."""

DENTS = 0.3e-3
"""m, how far the tool is moved further in on an uneven line, as along the edge of a floor."""

JOINED_TOLERANCE = 0.3e-3
"""m, the same on a joined path, whose turn ends one step inside its beginning."""


def inset(points: Array, away: Array, flat_radius: float, *, closed: bool) -> Array:
    """(N, 3) m, tips of the flat tool for the tips (N, 3) of its rounding.

    ``away`` (N, 3) unit, horizontally from the tool to the wall.

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL where the line turns more sharply, or runs closer to itself, than the flat fits
    """
    if flat_radius <= 0.0:
        return points
    line = shapely.LinearRing(points[:, :2]) if closed else shapely.LineString(points[:, :2])
    tips = points - flat_radius * away
    for _ in range(3):  # an uneven line: a little further in, as far as its dents reach
        missing = flat_radius - shapely.distance(line, shapely.points(tips[:, :2]))
        tips = tips - np.clip(missing, 0.0, DENTS / 3)[:, None] * away
    missing = flat_radius - shapely.distance(line, shapely.points(tips[:, :2]))
    worst = int(np.argmax(missing))
    if missing[worst] > (INSET_TOLERANCE if closed else JOINED_TOLERANCE):
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"the flat of the tool (radius {flat_radius * 1e3:.2f} mm) does not fit: it would overhang by "
            f"{missing[worst] * 1e3:.2f} mm",
            where=f"contour at {place_text(points[worst])}",
            advice="use a smaller tool_1.radius, or a hemisphere",
        )
    return tips


SLOWEST = 0.02
"""Part of the feed that is never undercut: a speed of zero would never leave a point."""


def with_speed(contours: Sequence[Contour], joins: Sequence[bool], acceleration: float | None) -> list[Contour]:
    """Contours with ``speed`` (m/s) for an ``acceleration`` limit (m/s^2); as they are without one.

    ``joins``: the contour begins where the one before ends and the tool runs on without a stop.
    """
    if acceleration is None:
        return list(contours)
    result: list[Contour] = []
    starts = [k for k, joined in enumerate(joins) if not joined]
    for begin, end in zip(starts, [*starts[1:], len(contours)], strict=True):
        result += _run(contours[begin:end], acceleration)
    return result


def speeds(points: Array, closed: bool, feed: float, acceleration: float) -> Array:
    """(N,) m/s along points (N, 3) m, starting and ending at rest; ``closed``: it ends at the first point."""
    line = np.vstack([points, points[:1]]) if closed else points
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    share = acceleration / np.sqrt(2.0)
    limit = np.full(len(line), feed)
    # the turn of the direction over two points before and after: single points carry the noise of settling
    reach = 2 if len(line) > 5 else 1
    before, after = line[reach:-reach] - line[: -2 * reach], line[2 * reach :] - line[reach:-reach]
    length = 0.5 * (np.linalg.norm(before, axis=1) + np.linalg.norm(after, axis=1))
    cosine = (before * after).sum(axis=1) / np.maximum(np.linalg.norm(before, axis=1), 1e-12)
    turn = np.arccos(np.clip(cosine / np.maximum(np.linalg.norm(after, axis=1), 1e-12), -1.0, 1.0))
    limit[reach:-reach] = np.minimum(feed, np.sqrt(share * length / np.maximum(turn, 1e-9)))
    limit[0] = limit[-1] = 0.0
    squares = limit**2
    for k in range(1, len(line)):
        squares[k] = min(squares[k], squares[k - 1] + 2 * share * step[k - 1])
    for k in range(len(line) - 2, -1, -1):
        squares[k] = min(squares[k], squares[k + 1] + 2 * share * step[k])
    return np.maximum(np.sqrt(squares), SLOWEST * feed)[: len(points)]


def _run(contours: Sequence[Contour], acceleration: float) -> list[Contour]:
    """Contours passed without a stop; the points where two of them meet are shared."""
    if len(contours) == 1 and contours[0].closed:
        only = contours[0]
        return [replace(only, speed=speeds(only.forming_tip, True, only.feed, acceleration))]
    line = np.vstack([contours[0].forming_tip[:1], *[contour.forming_tip[1:] for contour in contours]])
    speed = speeds(line, False, contours[0].feed, acceleration)
    cuts = np.cumsum([0] + [len(contour) - 1 for contour in contours])
    return [
        replace(contour, speed=speed[a : b + 1]) for contour, a, b in zip(contours, cuts[:-1], cuts[1:], strict=True)
    ]
