"""A contour whose support tool stood at the rig's offset limit, so that the set-point was out of its reach."""

from __future__ import annotations

import numpy as np
from isf_core.contour import ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError

TOLD_FROM = 0.1
"""Share of a contour's points at the limit from which it is told (assumed): the corners of a pyramid are fewer."""


def offset_warning(result: ContourResult, limit: float) -> IsfError | None:
    """OFFSET_LIMIT where a tenth of the points of ``result`` or more were formed at ``limit`` m; None otherwise.

    The contour is formed all the same, with another force than asked for: a warning, not a failure.
    """
    offset = result.force_offset[np.isfinite(result.force_offset)]
    if not len(offset):
        return None
    share = float((np.abs(offset) >= limit - 1e-9).mean())
    if share < TOLD_FROM:
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
