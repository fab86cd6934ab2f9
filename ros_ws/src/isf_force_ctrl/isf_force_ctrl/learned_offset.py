"""Feed-forward learned from the contour before: what the force loop had to do there, it will have to do again.

Neighbouring contours of a part see nearly the same gap errors at the same place (corners, sheet force, thinning).
The previous offset profile, looked up at the nearest place in the plane, is fed forward as increments; the feedback
only has to find what changed. In the language of iterative learning control the offset of contour k+1 is
u = S (Q u_k + feedback): with a zero-phase Q the limit is the exact inverse of the servo, and it is reached while
|S Q| < 1. S, the sensitivity of the force loop, exceeds 1 around its own crossover (some 5-15 Hz), so Q, two averages
over ``width``, must have faded there. Only increments are used, so switching it on cannot step the offset.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from isf_force_ctrl.segments import Column, Row

Array = NDArray[np.float64]


def expected_offset(places: Array, previous_places: Array, previous_offset: Array, width: int) -> Array:
    """(T,) m, change of the offset expected on the way along ``places`` (T, 2) m; 0 at the first.

    ``previous_places`` (K, 2) m and ``previous_offset`` (K,) m are the profile of the contour before, ``width`` the
    ticks of each of the two averages that smooth it.
    """
    nearest = np.asarray(cKDTree(previous_places).query(places)[1])
    smooth = _averaged(_averaged(previous_offset[nearest], width), width)
    return np.asarray(smooth - smooth[0])


def feed_forward(rows: list[Row], forming_tool: int, places: Array, offset: Array, width: int) -> None:
    """Fill the column LEARNED of a contour's ``rows`` from the profile of the contour before; see above."""
    if not len(offset):
        return
    tip = Column.TIP_1 if forming_tool == 1 else Column.TIP_2
    at = np.array([row[tip : tip + 2] for row in rows])
    for row, value in zip(rows, expected_offset(at, places, offset, width).tolist(), strict=True):
        row[Column.LEARNED] = value


def _averaged(profile: Array, width: int) -> Array:
    half = max(width // 2, 1)
    padded = np.concatenate([np.full(half, profile[0]), profile, np.full(half, profile[-1])])
    return np.asarray(np.convolve(padded, np.ones(2 * half + 1) / (2 * half + 1), mode="valid"))
