"""From a line of the forming tip to one contour: contacts, thickness, both tools."""

from __future__ import annotations

import numpy as np
from isf_core import thickness
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner import flat_tip, support_tool
from isf_planner.joined_paths import TipPath
from isf_planner.tip_loops import TipLoop

Array = NDArray[np.float64]


def path_of(loop: TipLoop) -> TipPath:
    """The closed path of one loop."""
    return TipPath(loop.tip, loop.normal, True, loop.feature, loop.forming_tool)


def make_contour(loop: TipLoop, job: Job, plan_id: str, index: int, count: int) -> Contour:
    """Contour of one closed loop; see :func:`contour_of`."""
    return contour_of(path_of(loop), job, plan_id, index, count)


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
        formed = thickness.sine_law(job.sheet.thickness, wall_angle)
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
        forming_tip=flat_tip.inset(points, away, forming.flat_radius, closed=path.closed),
        support_tip=support_tip,
        support_force=support_force,
        forming_tool=path.forming_tool,
        closed=path.closed,
        feature=path.feature,
    ).validate()
