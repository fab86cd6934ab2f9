"""Which contours pass over a floor: flat, at the level that the contour before has reached."""

from __future__ import annotations

import numpy as np

from isf_core.contour import Contour

FLAT = np.radians(1.0)
"""rad, wall angle of what is floor."""
SAME_LEVEL = 20e-6
"""m between the tips of a pass over the floor and of the contour before it."""


def makes_floor(contour: Contour) -> bool:
    """True when all points of ``contour`` lie on a floor."""
    return float(contour.wall_angle.max()) <= FLAT


def over_floor(contour: Contour, before: Contour | None) -> bool:
    """True when ``contour`` passes over the floor that the contour ``before`` it has reached, both as planned."""
    if before is None or (before.plan_id, before.feature, before.stage, before.forming_tool) != (
        contour.plan_id,
        contour.feature,
        contour.stage,
        contour.forming_tool,
    ):
        return False
    level = abs(float(contour.forming_tip[:, 2].mean() - before.forming_tip[:, 2].mean()))
    return level <= SAME_LEVEL and makes_floor(contour)
