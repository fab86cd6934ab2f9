"""Normals of the smooth surface that a faceted mesh stands for.

A facet's own normal is off by up to half the angle between neighbouring facets (some degrees). Normals at the
vertices, averaged with the weight area times corner angle (which does not depend on how quads were split) and
interpolated over the facet, follow the smooth surface to second order. Sharp edges stay sharp: corners whose
average is far from their facet keep the facet's normal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from isf_planner import surface_kernels
from isf_planner.mesh_input import Mesh

Array = NDArray[np.float64]

CREASE = np.radians(15.0)
"""rad, a vertex normal that deviates more from a facet lies on an edge (of twice this angle), not on a smooth face."""


FACETS_SMOOTHED = 4.0
"""Facets across which normals along a loop are smoothed."""


def facet_normals(mesh: Mesh) -> Array:
    """(F, 3) unit normals of the facets; zero for a facet without area."""
    return surface_kernels.vertex_normals(mesh.vertices, mesh.faces)[1]


def corner_normals(mesh: Mesh) -> Array:
    """(F, 3, 3) unit normals of the smooth surface at every facet's three corners."""
    vertex, facet = surface_kernels.vertex_normals(mesh.vertices, mesh.faces)
    normals = vertex[mesh.faces]
    on_edge = np.einsum("fcd,fd->fc", normals, facet) < np.cos(CREASE)
    normals[on_edge] = np.broadcast_to(facet[:, None, :], normals.shape)[on_edge]
    return np.asarray(normals)


def smoothing_width(facet_width: float, radius: float) -> float:
    """m along a loop over which normals of facets ``facet_width`` m wide need smoothing.

    Never more than the tool's ``radius`` (m). Smoothing beyond need hurts: where a straight side meets an arc the
    fitted parabola lags behind the jump of the curvature.
    """
    return min(radius, FACETS_SMOOTHED * facet_width)


def smooth_along(normals: Array, spacing: float, width: float) -> Array:
    """(N, 3) unit normals of a closed loop, smoothed over ``width`` (m) at point ``spacing`` (m).

    A local parabola (Savitzky-Golay) is fitted, so that the turn of the normals around a round loop keeps
    its size, which a plain mean would shrink.
    """
    count = len(normals)
    window = min(2 * round(width / spacing / 2) + 1, 2 * (count // 6) + 1)
    if window < 5:
        return normals
    smooth = savgol_filter(normals, window, 2, axis=0, mode="wrap")
    return np.asarray(smooth / np.linalg.norm(smooth, axis=1, keepdims=True))
