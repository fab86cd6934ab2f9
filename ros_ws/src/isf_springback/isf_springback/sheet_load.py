"""The axial force that bends the sheet, from what both load cells measured during one contour.

Squeezing the sheet between the tools is a self-equilibrated pair: it loads the tools and not the part. The load
that deflects the sheet is therefore the sum of the axial forces of both tools; without a reading of the support
tool the axial share of the squeeze follows from its horizontal normal force, F_nz = F_nxy cot(phi) (Ren 2018;
decomposition of section 2.3, its effect on the springback loop in the specification, section 7.2).

Forces are those of the sheet on the tool, N, axes of frame ``sheet``.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

SMALLEST_SQUEEZE_ANGLE = np.radians(10.0)
"""rad; below it cot(phi) says nothing any more: horizontal squeeze control is not used on nearly flat walls."""


def push_sign(contour: Contour) -> float:
    """z component of the push direction of the forming tool: -1 for the upper tool, +1 for the lower one."""
    return -1.0 if contour.forming_tool == 1 else 1.0


def axial_sheet_load(contour: Contour, result: ContourResult) -> Array:
    """(N,) N, load on the sheet along the push direction at the points of ``contour``; positive when pushing.

    Raises
    ------
    IsfError : NO_FORCE_HISTORY (the result has no forces or belongs to another path),
        CORRECTION_FAILED (forces that are not finite)
    """
    where = contour_label(contour.index)
    forming = np.asarray(result.forming_force, dtype=float)
    if forming.shape != (len(contour), 3):
        raise IsfError(
            ErrorCode.NO_FORCE_HISTORY,
            f"its result has forming forces of shape {forming.shape}, expected {(len(contour), 3)}",
            where=where,
            advice="force control must report the force at every contour point",
        )
    axial = forming[:, 2] + _support_share(contour, result)
    bad = ~np.isfinite(axial)
    if bad.any():
        raise IsfError(
            ErrorCode.CORRECTION_FAILED,
            f"the measured force is not finite at {int(bad.sum())} of {len(axial)} points",
            where=f"{where} point {int(np.argmax(bad))}",
            advice="check the load cell; the last good correction is kept",
        )
    return -push_sign(contour) * axial


def _support_share(contour: Contour, result: ContourResult) -> Array:
    """(N,) N, axial force on the support tool: measured, else from the horizontal normal force."""
    if not contour.has_support:
        return np.zeros(len(contour))
    support = np.asarray(result.support_force, dtype=float)
    if support.shape == (len(contour), 3):
        return np.asarray(support[:, 2])
    horizontal = contour.support_force if contour.force_controlled else np.zeros(len(contour))
    angle = np.maximum(contour.wall_angle, SMALLEST_SQUEEZE_ANGLE)
    return np.asarray(push_sign(contour) * horizontal / np.tan(angle))
