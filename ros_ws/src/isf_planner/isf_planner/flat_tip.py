"""Flat tips with a rounded edge: from the tip of the rounding, planned as a ball, to the tip of the tool.

The tool is the disc of the flat swept by the ball of the corner radius. So where the ball may run at a level, the
tool may run inside by the flat radius, and its contacts are those of the ball.
"""

from __future__ import annotations

import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

from isf_planner.mesh_checks import place_text

Array = NDArray[np.float64]

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
            f"the flat of the tool (radius {flat_radius * 1e3:.2f} mm) does not fit: it would stand over by "
            f"{missing[worst] * 1e3:.2f} mm",
            where=f"contour at {place_text(points[worst])}",
            advice="use a smaller tool_1.radius, or a hemisphere",
        )
    return tips
