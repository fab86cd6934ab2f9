"""Thickness of the formed sheet by volume constancy, and how far it is used up, with the material's real motion.

Under the tool the sheet moves along its present normal, so on a wall the material moves sideways as well as down
(the kinematics of the overlap method, Praveen 2020, 2.1). The surface carries for every node where its material lay
on the flat blank; the thickness follows from the area there over the area of the surface now:
t = t0 det(dX/dx) / sqrt(1 + |grad z|^2). A single pass gives the sine law t0 cos(alpha) in the developed wall, later
passes stretch what is there instead of starting from the blank again. The principal strains are those of the same
motion.
"""

from __future__ import annotations

import numpy as np
from isf_core.files.material import FormingLimit
from isf_core.types import Array
from scipy.ndimage import gaussian_filter

from isf_sim.jit import kernel
from isf_sim.sheet.surface import Surface, bilinear

SMOOTHING = 1.5
"""Blank thicknesses: waves of the surface shorter than the sheet is thick do not thin it."""
THINNEST = 0.05
"""Smallest thickness over the blank's that is told; a sheet has broken long before."""
WALL_NEAR, WALL_FAR, WALL_PLACES = 0.6, 2.2, 9
"""Tool radii up the wall between which its thinnest place is looked for, and places there."""
REACH_CELLS = 3.0
"""Cells of the fine grid to either side, over which differences are taken."""


def thickness_map(surface: Surface, blank: float) -> Array:
    """(ny, nx) m, thickness normal to the surface on the nodes of ``surface``; ``blank`` m before forming."""
    sigma = SMOOTHING * blank / surface.h
    zy, zx = np.gradient(gaussian_filter(surface.height, sigma), surface.h)
    area = _origin_area(gaussian_filter(surface.origin, (sigma, sigma, 0.0)), surface.h, surface.h)
    return np.asarray(blank * np.maximum(area / np.sqrt(1.0 + zx**2 + zy**2), THINNEST))


@kernel
def strain_up_the_wall(
    surface: Surface, x: float, y: float, wall: Array, radius: float, slope_of_limit: float, bent: float, place: Array
) -> float:
    """Largest strain of the wall beside a tool of ``radius`` m at (x, y) m, as the forming limit counts it
    (:class:`isf_core.files.material.FormingLimit`), and its ``place`` (3,) m.

    ``wall`` (4,): as in Contact, the wall's direction in 1 and 2; without one the answer is 0. ``slope_of_limit``: k,
    with 1 the strain is ln(t0 / t). ``bent`` m: strain per sum of curvatures, 0 leaves bending out.
    """
    worst = 0.0
    place[0], place[1], place[2] = x, y, bilinear(surface.height, surface.x0, surface.y0, surface.h, x, y)
    if wall[1] == 0.0 and wall[2] == 0.0:
        return worst
    reach = REACH_CELLS * surface.h
    slope, origin_x, origin_y = np.empty(2), np.empty(2), np.empty(2)
    for n in range(WALL_PLACES):
        distance = radius * (WALL_NEAR + (WALL_FAR - WALL_NEAR) * n / (WALL_PLACES - 1.0))
        px, py = x + distance * wall[1], y + distance * wall[2]
        for axis in range(2):
            ax, ay = (reach, 0.0) if axis == 0 else (0.0, reach)
            slope[axis] = _difference(surface.height, surface, px, py, ax, ay)
            origin_x[axis] = _difference(surface.origin[:, :, 0], surface, px, py, ax, ay)
            origin_y[axis] = _difference(surface.origin[:, :, 1], surface, px, py, ax, ay)
        area = (1.0 + origin_x[0]) * (1.0 + origin_y[1]) - origin_x[1] * origin_y[0]
        left = max(area / np.sqrt(1.0 + slope[0] ** 2 + slope[1] ** 2), THINNEST)
        strain = -np.log(left)
        if slope_of_limit != 1.0:
            strain += (slope_of_limit - 1.0) * minor_strain(origin_x, origin_y, slope)
        if bent > 0.0:
            strain += bent * bilinear(surface.bending, surface.x0, surface.y0, surface.h, px, py)
        if strain > worst:
            worst = strain
            place[0], place[1] = px, py
            place[2] = bilinear(surface.height, surface.x0, surface.y0, surface.h, px, py)
    return worst


@kernel
def minor_strain(origin_x: Array, origin_y: Array, slope: Array) -> float:
    """Smaller principal true strain in the sheet: of its plane, from the slopes (2,) of origin and height along x, y.

    A way dx in the plane is |A dx| long on the blank and sqrt(dx . M dx) now; A = 1 + grad origin, M = 1 + slope
    slope^T.
    """
    a, b, c, d = 1.0 + origin_x[0], origin_x[1], origin_y[0], 1.0 + origin_y[1]
    xx, xy, yy = a * a + c * c, a * b + c * d, b * b + d * d  # A^T A
    area = xx * yy - xy * xy
    if area <= 0.0:
        return 0.0
    mx, my, mxy = 1.0 + slope[0] ** 2, 1.0 + slope[1] ** 2, slope[0] * slope[1]
    half = 0.5 * (yy * mx + xx * my - 2.0 * xy * mxy) / area
    product = (mx * my - mxy * mxy) / area
    return 0.5 * np.log(product / (half + np.sqrt(max(half * half - product, 0.0))))


@kernel
def _difference(values: Array, surface: Surface, x: float, y: float, ax: float, ay: float) -> float:
    """Slope of ``values`` on the fine grid between (x - ax, y - ay) and (x + ax, y + ay) m."""
    ahead = bilinear(values, surface.x0, surface.y0, surface.h, x + ax, y + ay)
    behind = bilinear(values, surface.x0, surface.y0, surface.h, x - ax, y - ay)
    return (ahead - behind) / (2.0 * (ax + ay))


def coarse_area(origin: Array, x: Array, y: Array) -> Array:
    """(len(y), len(x)) area on the blank over plan area now, from ``origin`` (len(y), len(x), 2) m on the lines m."""
    return _origin_area(origin, y, x)


def limit_margin(surface: Surface, blank: float, limit: FormingLimit) -> Array:
    """(ny, nx) true strain that is left before ``limit`` on the nodes of ``surface``, negative beyond it; ``blank`` m.

    Strains and bends count as beside the tool (:func:`strain_up_the_wall`), so that a wall that tears has none left.
    What the support tool squeezes, and what its squeeze lets the sheet bear beyond the limit, is left out.
    """
    slope, x, y = (
        _differences(values, surface.h) for values in (surface.height, surface.origin[..., 0], surface.origin[..., 1])
    )
    area = (1.0 + x[..., 0]) * (1.0 + y[..., 1]) - x[..., 1] * y[..., 0]
    strain = -np.log(np.maximum(area / np.sqrt(1.0 + (slope**2).sum(axis=-1)), THINNEST))
    if limit.slope != 1.0:
        nodes = zip(*(values.reshape(-1, 2) for values in (x, y, slope)), strict=True)
        strain += (limit.slope - 1.0) * np.array([minor_strain(*node) for node in nodes]).reshape(strain.shape)
    return np.asarray(limit.strain - strain - 0.5 * blank * limit.bending_share * surface.bending)


def _differences(values: Array, h: float) -> Array:
    """(ny, nx, 2), slopes of ``values`` along x and y over REACH_CELLS to either side, clamped at the border."""
    reach = round(REACH_CELLS)
    wide = np.pad(values, reach, mode="edge")
    inner = slice(reach, -reach)
    along = wide[inner, 2 * reach :] - wide[inner, : -2 * reach], wide[2 * reach :, inner] - wide[: -2 * reach, inner]
    return np.stack(along, axis=-1) / (2.0 * reach * h)


def _origin_area(origin: Array, y: Array | float, x: Array | float) -> Array:
    """Area on the blank over plan area; ``y``, ``x``: lines m or their spacing."""
    xy, xx = np.gradient(origin[..., 0], y, x)
    yy, yx = np.gradient(origin[..., 1], y, x)
    return np.asarray((1.0 + xx) * (1.0 + yy) - xy * yx)
