"""From contact points to tool tips for spherical tools (Ren 2018, section 2.9; Praveen 2020 eq. 17-18).

Contact points lie on the sheet surface that the forming tool touches; normals point out of
the sheet towards the forming tool.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def forming_tip(contact: Array, normal: Array, radius: float, *, upper: bool = True) -> Array:
    """(N, 3) m, tip of the forming tool: lowest point of an upper, highest point of a lower tool."""
    centre = contact + radius * normal
    return _tip(centre, radius, upper=upper)


def support_tip(contact: Array, normal: Array, radius: float, gap: Array | float, *, upper: bool = False) -> Array:
    """(N, 3) m, tip of the support tool at ``gap`` (m, scalar or (N,)) below the contact along the normal.

    The ball centres are then at the distance R1 + R2 + gap (R1: forming tool).
    """
    reach = np.asarray(gap) + radius
    centre = contact - np.reshape(reach, (-1, 1)) * normal
    return _tip(centre, radius, upper=upper)


def tool_gap(forming: Array, support: Array, forming_radius: float, support_radius: float) -> Array:
    """(N,) m, free distance of the two balls whose tips are given; upper forming tool."""
    offset = np.array([0.0, 0.0, 1.0])
    first = forming + forming_radius * offset
    second = support - support_radius * offset
    return np.asarray(np.linalg.norm(second - first, axis=-1) - forming_radius - support_radius)


def _tip(centre: Array, radius: float, *, upper: bool) -> Array:
    return np.asarray(centre + np.array([0.0, 0.0, -radius if upper else radius]))
