"""From a loop of the tip to one contour: contacts, thickness, support tool."""

from __future__ import annotations

import numpy as np
from isf_core import thickness, tip_geometry
from isf_core.contour import Contour
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner.tip_loops import TipLoop

Array = NDArray[np.float64]


def make_contour(loop: TipLoop, job: Job, plan_id: str, index: int, count: int) -> Contour:
    """Contour of a loop for the job's tools: sine-law thickness, support tip at squeeze factor times thickness."""
    radius = job.tool_1.radius
    contact = loop.contact(radius)
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
            support_force = np.full(len(contact), control.support_force)
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
