"""Thickness of the formed sheet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def sine_law(initial: float, wall_angle: Array | float) -> Array:
    """Thickness (m) after forming a wall at ``wall_angle`` (rad from horizontal): t0 cos(phi).

    Plane strain, all deformation in the forming zone (Ren 2018, section 1.1.2).
    """
    return np.asarray(initial * np.cos(wall_angle))
