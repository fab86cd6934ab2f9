"""Warnings about a contour: a support force from which the sheet sheds chips, a support tool at the rig's offset limit,
a force that the machine bears only because a simulated sheet overstates it.

The limit of chips: :mod:`isf_core.support_window`. N, m.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from isf_core.contour import Contour, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.process.support_window import support_window
from isf_core.simulated_sheet import raised_limit_text


class ChipWatch:
    """Looks at the contours of a plan; ``support_force`` N replaces their set-points, None: they keep theirs."""

    def __init__(self, job_file: JobFile, support_force: float | None) -> None:
        self._job_file, self._support_force = job_file, support_force
        self._reported = False

    def check(self, contour: Contour) -> str:
        """The warning of the first contour that needs one; empty for all others."""
        text = "" if self._reported else chip_warning(self._job_file, contour, self._support_force)
        self._reported = self._reported or bool(text)
        return f"{contour_label(contour.index)}: {text}" if text else ""


def chip_warning(job_file: JobFile, contour: Contour, support_force: float | None) -> str:
    """What to say about the force set-points of ``contour`` on the job's sheet; empty when they leave it fine.

    ``support_force`` N replaces the set-points; None: those of the contour. The worst point of the contour is told.
    """
    job, rig, material = job_file.job, job_file.rig, job_file.material
    if job.tool_2 is None or not contour.force_controlled:
        return ""
    force = contour.support_force if support_force is None else np.full(len(contour), support_force)
    radius = min(job.tool_1.ball_radius, job.tool_2.ball_radius)
    most = support_window(
        material.tensile_strength, radius, job.sheet.thickness, rig.contact_stiffness, rig.limits.offset
    ).chips_at(contour.wall_angle)
    worst = int(np.argmax(force - most))
    if force[worst] <= most[worst]:
        return ""
    return (
        f"support force of {force[worst]:.0f} N on a wall of {np.degrees(contour.wall_angle[worst]):.0f} deg: "
        f"{material.name} of {1e3 * job.sheet.thickness:g} mm may shed chips under tools of {1e3 * radius:g} mm from "
        f"{most[worst]:.0f} N on"
    )


REPORTED_FROM = 0.1
"""Share of a contour's points at the limit from which it is told (assumed): the corners of a pyramid are fewer."""


def offset_warning(result: ContourResult, limit: float) -> IsfError | None:
    """OFFSET_LIMIT where a tenth of the points of ``result`` or more were formed at ``limit`` m; None otherwise.

    The contour is formed all the same, with another force than asked for: a warning, not a failure.
    """
    offset = result.force_offset[np.isfinite(result.force_offset)]
    if not len(offset):
        return None
    share = float((np.abs(offset) >= limit - 1e-9).mean())
    if share < REPORTED_FROM:
        return None
    engaged = result.tick_engaged.astype(bool)
    force = ""
    if engaged.any() and len(result.tick_set_point):
        mean, asked = float(result.tick_normal_force[engaged].mean()), float(result.tick_set_point[engaged].mean())
        force = f"; mean normal force {mean:.0f} N, set-point {asked:.0f} N"
    return IsfError(
        ErrorCode.OFFSET_LIMIT,
        f"the support tool was at its offset limit of {1e3 * limit:.2f} mm for {100 * share:.0f} % of the points"
        f"{force}",
        where=contour_label(result.index),
        advice="check sheet thickness, tool radii and alignment; then lower the force or raise limits.offset",
    )


def with_overload(result: ContourResult, job_file: JobFile) -> ContourResult:
    """``result`` of a machine with a raised force limit (:meth:`JobFile.with_force_raised`), with what the rig bears:
    as a warning FORCE_LIMIT where the contour took more, or beside the reach of the load cells that ended it."""
    if job_file.force_raised == 1.0:
        return result
    if result.code == ErrorCode.WRENCH_OUT_OF_RANGE:
        return replace(result, message=f"{result.message}; that is {raised_limit_text(job_file)}")
    rig, bears, axes = job_file.rig.name, np.asarray(job_file.rig_force), "xyz"
    for tool, force in (1, result.forming_force), (2, result.support_force):
        most = np.nan_to_num(np.abs(force)).max(axis=0, initial=0.0)
        if result.completed and not result.code and (most > bears).any():
            axis = int(np.argmax(most / bears))
            taken = f"tool {tool} took {most[axis]:.0f} N in {axes[axis]}, {rig} bears {bears[axis]:.0f} N"
            why = f"cells of this size overstate the force by up to {job_file.force_raised:g} times"
            return replace(
                result, code=int(ErrorCode.FORCE_LIMIT), message=f"{taken}; a real sheet may take less: {why}"
            )
    return result
