"""Free distance of two balls, for tests of where tools stand."""

import numpy as np
from isf_core.types import Array


def tool_gap(forming: Array, support: Array, forming_radius: float, support_radius: float) -> Array:
    """(N,) m, free distance of the two balls whose tips are given; upper forming tool."""
    offset = np.array([0.0, 0.0, 1.0])
    first = forming + forming_radius * offset
    second = support - support_radius * offset
    return np.asarray(np.linalg.norm(second - first, axis=-1) - forming_radius - support_radius)
