"""Where the tools of accumulative DSIF stand for a position angle and a gap, and back (Ren 2018, 3.1.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def support_tip(forming_tip: Array, away: Array, theta: Array, gap: Array, radii: tuple[float, float]) -> Array:
    """(N, 3) m, tip of the lower support ball.

    Parameters
    ----------
    forming_tip : (N, 3) m, of the upper forming ball
    away : (N, 3) unit, horizontally across the path, outwards
    theta : (N,) rad, between the vertical and the line through both centres
    gap : (N,) m, free distance of the balls
    radii : m, of the forming and the support ball
    """
    forming, support = radii
    line = np.sin(theta)[:, None] * away - np.cos(theta)[:, None] * np.array([0.0, 0.0, 1.0])
    centre = forming_tip + np.array([0.0, 0.0, forming]) + (forming + support + np.asarray(gap))[:, None] * line
    return np.asarray(centre + np.array([0.0, 0.0, support]))


def angle_and_gap(forming_tip: Array, support_tip: Array, radii: tuple[float, float]) -> tuple[Array, Array]:
    """Position angle (N,) rad and gap (N,) m of two balls from their tips (N, 3) m; forming tool above."""
    forming, support = radii
    line = support_tip - forming_tip - np.array([0.0, 0.0, forming + support])
    distance = np.linalg.norm(line, axis=1)
    return np.arccos(np.clip(-line[:, 2] / distance, -1.0, 1.0)), distance - forming - support
