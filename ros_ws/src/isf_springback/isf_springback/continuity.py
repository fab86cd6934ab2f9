"""What was corrected last, and the limited step from there to the next contour.

Every method corrects through this state, so that no change of method, missing force or wrong order makes the tools
jump: the new correction leaves the last one by at most the change limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array

from isf_springback.correction_limits import CorrectionLimits, LimitedCorrection, limit_correction
from isf_springback.loop_path import LoopPath, nearest_points

GRADIENT = 50e-6 / 1e-3
"""m of correction per m of path (published: Ren 2018, 4.3.1)."""

CHANGE_PER_DEPTH = 2.0
"""Largest change from contour to contour in incremental depths (published: Ren 2018, 4.3.1)."""

MAGNITUDE = 10e-3
"""m, largest correction (assumed: twice the 5.4 mm predicted for the largest published part, Praveen 2020, 3.2)."""


def limits_of(job_file: JobFile, forming_tool: int = 1) -> CorrectionLimits:
    """Published limits for the tools and the incremental depth of a job."""
    return CorrectionLimits(
        gradient=GRADIENT,
        smoothing=2.0 * forming_radius(job_file, forming_tool),
        change=CHANGE_PER_DEPTH * job_file.job.path.incremental_depth,
        magnitude=MAGNITUDE,
    )


def forming_radius(job_file: JobFile, forming_tool: int) -> float:
    """m, radius of the forming tool of a contour."""
    job = job_file.job
    tool = job.tool_1 if forming_tool == 1 or job.tool_2 is None else job.tool_2
    return tool.radius


@dataclass(frozen=True)
class Applied:
    """Correction given to a contour: ``place`` (N, 2) m, ``value`` (N,) m along the push direction."""

    plan_id: str
    index: int
    feature: int
    forming_tool: int
    place: Array
    value: Array

    def seen_from(self, contour: Contour) -> Array:
        """(N,) m, the value at the nearest place in plan view from every point of another contour."""
        nearest = nearest_points(contour.forming_tip[:, :2], self.place)
        return np.asarray(self.value[nearest])


class Continuity:
    """The last contour (``base``) and the one being formed (``pending``) with their corrections.

    Before the first contour the tools are lifted, and so when they swap or travel to another feature: there is no base,
    and no change to limit. The depth that they go to at once is bounded by the largest correction alone.
    """

    def __init__(self) -> None:
        self.base: Applied | None = None
        self.pending: Applied | None = None

    def advance(self, contour: Contour) -> IsfError | None:
        """Prepare for ``contour``; returns CONTOUR_OUT_OF_ORDER when it does not follow the last one.

        Asking again for the same contour starts from the same base; a new plan starts anew.
        """
        pending = self.pending
        if pending is None or pending.plan_id != contour.plan_id:
            self.base = self.pending = None
            return None
        if contour.index == pending.index:
            return None
        lifted = contour.retract and contour.stage == 0 and contour.feature != pending.feature
        self.base = None if lifted or pending.forming_tool != contour.forming_tool else pending
        if contour.index == pending.index + 1:
            return None
        return IsfError(
            ErrorCode.CONTOUR_OUT_OF_ORDER,
            f"{contour_label(contour.index)} came after {contour_label(pending.index)}",
            where=f"plan {contour.plan_id}",
            advice="contours must come in the order of the plan; the last good correction is kept",
        )

    def last_good(self, contour: Contour) -> Array:
        """(N,) m, the last correction seen from ``contour``; zero when there is none."""
        return np.zeros(len(contour)) if self.base is None else self.base.seen_from(contour)

    def apply_limits(self, contour: Contour, requested: Array, limits: CorrectionLimits) -> LimitedCorrection:
        """Limited correction of ``contour``, remembered as pending."""
        base = self.base
        if base is None:
            limits = replace(limits, change=limits.magnitude)
        limited = limit_correction(
            requested,
            LoopPath.of(contour),
            limits,
            previous=None if base is None else base.seen_from(contour),
            start=None if base is None else float(base.value[-1]),
        )
        self.remember(contour, limited.value)
        return limited

    def remember(self, contour: Contour, value: Array) -> None:
        """``contour`` is formed with the correction ``value`` (N,) m."""
        self.pending = Applied(
            contour.plan_id,
            contour.index,
            contour.feature,
            contour.forming_tool,
            contour.forming_tip[:, :2].copy(),
            value,
        )
