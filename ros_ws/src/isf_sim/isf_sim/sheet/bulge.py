"""Bulge of flat walls and pillow of the base in the measured shape; an overlay, not part of the state.

The tool leaves a residual moment in the sheet. Its normal displacement b follows lap b - b/l^2 = -k_b on formed or
enclosed cells and is zero elsewhere, with k_b = c_b 3 Rm/(E t) and 1/l^2 = k_s sqrt(12 (1 - nu^2))/t, k_s the
largest principal curvature: curved walls are stiff and hardly bulge. Cells bulge towards the side of the tool that has
formed them, or what lies next to them.
"""

from __future__ import annotations

import math

import numpy as np
from isf_core.files.material import Material
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, distance_transform_edt, gaussian_filter
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import spsolve

from isf_sim.sheet.surface import Surface


def bulge_overlay(surface: Surface, stride: int, strength: float, thickness: float, material: Material) -> Array:
    """(ny, nx) m, vertical overlay b sqrt(1 + |grad Z|^2) on every ``stride``-th node of the fine grid.

    ``strength`` c_b; ``thickness`` m of the blank.
    """
    h = stride * surface.h
    smooth = gaussian_filter(surface.height, 1.5 * thickness / surface.h)[::stride, ::stride]
    formed = surface.formed[::stride, ::stride]
    inside = np.array(binary_fill_holes(formed != 0))
    inside[0], inside[-1], inside[:, 0], inside[:, -1] = False, False, False, False
    overlay = np.zeros(smooth.shape)
    if not inside.any():
        return overlay
    zy, zx = np.gradient(smooth, h)
    stretch = np.sqrt(1.0 + zx**2 + zy**2)
    t = thickness / stretch
    foundation = _largest_curvature(zx, zy, h) * math.sqrt(12.0 * (1.0 - material.poisson_ratio**2)) / t
    source = strength * 3.0 * material.tensile_strength / (material.young_modulus * t)
    if (formed < 0).any():
        rows, columns = distance_transform_edt(formed == 0, return_distances=False, return_indices=True)
        source = source * formed[rows, columns]
    overlay[inside] = _solve(inside, zx, zy, foundation, source, h)
    return overlay * stretch


def _largest_curvature(zx: Array, zy: Array, h: float) -> Array:
    """1/m, magnitude of the larger principal curvature of a height field with slopes zx, zy."""
    zyy, zyx = np.gradient(zy, h)
    _, zxx = np.gradient(zx, h)
    a = 1.0 + zx**2 + zy**2
    mean = 0.5 * ((1.0 + zy**2) * zxx - 2.0 * zx * zy * zyx + (1.0 + zx**2) * zyy) / a**1.5
    gauss = (zxx * zyy - zyx**2) / a**2
    return np.asarray(np.abs(mean) + np.sqrt(np.maximum(mean**2 - gauss, 0.0)))


def _solve(inside: NDArray[np.bool_], zx: Array, zy: Array, foundation: Array, source: Array, h: float) -> Array:
    """Five-point scheme along the surface (distances stretched by the slope in x and in y)."""
    number = np.full(inside.shape, -1)
    number[inside] = np.arange(inside.sum())
    rows, columns = np.nonzero(inside)
    own = number[rows, columns]
    cx = 1.0 / (1.0 + zx[rows, columns] ** 2) / h**2
    cy = 1.0 / (1.0 + zy[rows, columns] ** 2) / h**2
    entries = [(own, own, -2.0 * (cx + cy) - foundation[rows, columns])]
    for dj, di, weight in ((0, 1, cx), (0, -1, cx), (1, 0, cy), (-1, 0, cy)):
        other = number[rows + dj, columns + di]
        held = other < 0
        entries.append((own[~held], other[~held], weight[~held]))
    i, j, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    matrix = csc_matrix((values, (i, j)), shape=(len(own), len(own)))
    return np.asarray(spsolve(matrix, -source[rows, columns]))
