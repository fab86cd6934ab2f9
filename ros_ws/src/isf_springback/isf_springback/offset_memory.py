"""Offsets in three directions from contour to contour: what was applied last, and bounded steps from there.

The counterpart of :mod:`isf_springback.continuity` for methods that look at the formed shape: their corrections may
pull back as well as push, because over-forming is measured too, and may have horizontal parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.continuity import CHANGE_PER_DEPTH, GRADIENT, MAGNITUDE, forming_radius
from isf_springback.correction_limits import limit_gradient
from isf_springback.loop_path import LoopPath, moving_average, nearest_points

HORIZONTAL_GRADIENT = 0.2
"""m of horizontal offset per m of path (assumed; the published 0.05 of the push would smear the corners of a
pyramid, where horizontal springback rises by 1.5 mm within some 10 mm of path, Lu 2016, 4.3.2)."""

VISIBLE = 1e-6
"""m; a smaller effect of a limit is not reported."""


@dataclass(frozen=True)
class SignedLimits:
    """Limits of one component: slope along the path, m averaged, m change per contour, m in all."""

    gradient: float
    smoothing: float
    change: float
    magnitude: float


def push_limits(
    job_file: JobFile, tool: int, magnitude: float = MAGNITUDE, change: float | None = None
) -> SignedLimits:
    """Limits of the axial component (Ren 2018, 4.3.1); ``change`` m in place of the published one."""
    if change is None:
        change = CHANGE_PER_DEPTH * job_file.job.path.incremental_depth
    return SignedLimits(GRADIENT, 2.0 * forming_radius(job_file, tool), change, magnitude)


def horizontal_limits(job_file: JobFile, tool: int, magnitude: float = MAGNITUDE) -> SignedLimits:
    """Limits of the horizontal component; smoothed over half the way of the push, so that corners stay."""
    change = CHANGE_PER_DEPTH * job_file.job.path.incremental_depth
    return SignedLimits(HORIZONTAL_GRADIENT, forming_radius(job_file, tool), change, magnitude)


def limit_signed(
    requested: Array, path: LoopPath, limits: SignedLimits, previous: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Admissible component (N,) m near ``requested`` (N,), and where a limit changed it.

    ``previous`` (N,) m is the component of the contour before, seen from this one.
    """
    within = np.clip(requested, -limits.magnitude, limits.magnitude)
    smooth = moving_average(path, within, limits.smoothing)
    value = moving_average(path, limit_gradient(path, within, limits.gradient), limits.smoothing)
    base = limit_gradient(path, np.clip(previous, -limits.magnitude, limits.magnitude), limits.gradient)
    value = np.clip(value, base - limits.change, base + limits.change)
    limited = (np.abs(value - smooth) > VISIBLE) | (np.abs(requested) > limits.magnitude)
    return np.asarray(value), np.asarray(limited)


@dataclass(frozen=True)
class AppliedOffset:
    """The nominal contour and the offset (N, 3) m it was formed with."""

    contour: Contour
    offset: Array

    def seen_from(self, contour: Contour) -> Array:
        """(N, 3) m, the offset at the nearest place in plan view from every point of another contour."""
        nearest = nearest_points(contour.forming_tip[:, :2], self.contour.forming_tip[:, :2])
        return np.asarray(self.offset[nearest])


class OffsetMemory:
    """The last contour (``base``) and the one being formed (``pending``) with their offsets."""

    def __init__(self) -> None:
        self.base: AppliedOffset | None = None
        self.pending: AppliedOffset | None = None

    def advance(self, contour: Contour) -> IsfError | None:
        """Prepare for ``contour``; returns CONTOUR_OUT_OF_ORDER when it does not follow the last one.

        Asking again for the same contour starts from the same base; a new plan starts anew.
        """
        pending = self.pending
        if pending is None or pending.contour.plan_id != contour.plan_id:
            self.base = self.pending = None
            return None
        if contour.index == pending.contour.index:
            return None
        self.base = pending if pending.contour.forming_tool == contour.forming_tool else None
        if contour.index == pending.contour.index + 1:
            return None
        return IsfError(
            ErrorCode.CONTOUR_OUT_OF_ORDER,
            f"{contour_label(contour.index)} came after {contour_label(pending.contour.index)}",
            where=f"plan {contour.plan_id}",
            advice="contours must come in the order of the plan; the last good correction is kept",
        )

    def last(self, contour: Contour) -> Array:
        """(N, 3) m, the last offset seen from ``contour``; zero when there is none."""
        return np.zeros((len(contour), 3)) if self.base is None else self.base.seen_from(contour)

    def remember(self, contour: Contour, offset: Array) -> None:
        """``contour`` is formed with ``offset`` (N, 3) m."""
        self.pending = AppliedOffset(contour, np.array(offset))
