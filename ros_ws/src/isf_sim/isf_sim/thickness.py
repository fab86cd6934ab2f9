"""Thickness of the formed sheet by volume constancy, with the material's real motion.

Under the tool the sheet moves along its present normal, so on a wall the material moves sideways as well as down
(the kinematics of the overlap method, Praveen 2020, 2.1). The surface carries for every node where its material lay
on the flat blank; the thickness follows from the area there over the area of the surface now:
t = t0 det(dX/dx) / sqrt(1 + |grad z|^2). A single pass gives the sine law t0 cos(alpha) in the developed wall, later
passes stretch what is there instead of starting from the blank again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from isf_sim.surface import Surface

Array = NDArray[np.float64]

SMOOTHING = 1.5
"""Blank thicknesses: waves of the surface shorter than the sheet is thick do not thin it."""
THINNEST = 0.05
"""Smallest thickness over the blank's that is told; a sheet has broken long before."""


def thickness_map(surface: Surface, blank: float) -> Array:
    """(ny, nx) m, thickness normal to the surface on the nodes of ``surface``; ``blank`` m before forming."""
    sigma = SMOOTHING * blank / surface.h
    zy, zx = np.gradient(gaussian_filter(surface.height, sigma), surface.h)
    area = _origin_area(gaussian_filter(surface.origin, (sigma, sigma, 0.0)), surface.h, surface.h)
    return np.asarray(blank * np.maximum(area / np.sqrt(1.0 + zx**2 + zy**2), THINNEST))


def coarse_area(surface: Surface, x: Array, y: Array) -> Array:
    """(len(y), len(x)) area on the blank over plan area now, from differences over the given nodes m."""
    ny, nx = surface.height.shape
    i = np.clip(np.rint((x - surface.x0) / surface.h).astype(int), 0, nx - 1)
    j = np.clip(np.rint((y - surface.y0) / surface.h).astype(int), 0, ny - 1)
    return _origin_area(surface.origin[np.ix_(j, i)], y, x)


def limit_margin(thickness: Array, blank: float, max_wall_angle: float) -> Array:
    """ln(1 / cos(a_max)) - ln(t0 / t): thinning that is left before the forming limit, negative beyond it.

    The limit is that of one pass at the material's largest wall angle (rad), where the sine law holds.
    """
    return np.asarray(-np.log(np.cos(max_wall_angle)) - np.log(blank / thickness))


def _origin_area(origin: Array, y: Array | float, x: Array | float) -> Array:
    """Area on the blank over plan area; ``y``, ``x``: lines m or their spacing."""
    xy, xx = np.gradient(origin[..., 0], y, x)
    yy, yx = np.gradient(origin[..., 1], y, x)
    return np.asarray((1.0 + xx) * (1.0 + yy) - xy * yx)
