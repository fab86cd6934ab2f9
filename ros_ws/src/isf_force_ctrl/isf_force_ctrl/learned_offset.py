"""Feed-forward learned from the contour before: what the force loop had to do there, it will have to do again.

Neighbouring contours of a part see nearly the same gap errors at the same place (corners, sheet force, thinning).
The previous offset profile, looked up at the nearest place in the plane and advanced by the delay of the servo, is
fed forward as increments; the feedback only has to find what changed. Only increments are used, so switching it on
cannot step the offset.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]


def expected_offset(places: Array, previous_places: Array, previous_offset: Array, lead: int, width: int) -> Array:
    """(T,) m, offset expected at ``places`` (T, 2) m from a previous contour's profile.

    Parameters
    ----------
    previous_places, previous_offset : (K, 2) m and (K,) m
    lead : ticks by which the profile is advanced
    width : ticks of the average that smooths it
    """
    nearest = np.asarray(cKDTree(previous_places).query(places)[1])
    profile = np.concatenate([previous_offset[nearest], np.full(lead, previous_offset[nearest[-1]])])[lead:]
    half = max(width // 2, 1)
    padded = np.concatenate([np.full(half, profile[0]), profile, np.full(half, profile[-1])])
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.asarray(np.convolve(padded, kernel, mode="valid"))
