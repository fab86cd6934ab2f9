"""Flat triangular shell facets: linear stiffness in the facet's own frame, for all facets of a mesh at once.

Membrane: the optimal triangle with drilling rotations (OPT of the ANDES family; Felippa 2003). Bending: discrete
Kirchhoff triangle (DKT; Batoz et al. 1980). Both are reduced to what deforms the facet, the six rigid modes
being taken out by the corotational frame of :mod:`isf_springback.shell.corotation`:

* membrane: change of l, x_3, y_3 (node 1 at the origin, node 2 at (l, 0), node 3 at (x_3, y_3)) and three drilling
  rotations,
* bending: two out-of-plane rotations (theta_x, theta_y) of each node.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

Index = NDArray[np.int64]

_ALPHA = 1.5
_BETA = (1.0, 2.0, 1.0, 0.0, 1.0, -1.0, -1.0, -1.0, -2.0)
"""Free parameters of the optimal membrane triangle (Felippa 2003, table 3)."""


@dataclass(frozen=True)
class Facets:
    """Facets at rest, T of them.

    Attributes
    ----------
    frame : (T, 3, 3) rows are the unit vectors e1 (side 1-2), e2, e3 (normal)
    shape : (T, 3) m, l, x_3, y_3
    membrane : (T, 6, 6) stiffness of (l, x_3, y_3, three drilling angles); N/m, N/rad, N m/rad
    bending : (T, 6, 6) N m/rad, stiffness of three pairs (theta_x, theta_y)
    """

    frame: Array
    shape: Array
    membrane: Array
    bending: Array


def make_facets(points: Array, triangles: Index, thickness: Array, young: float, poisson: float) -> Facets:
    """Facets of ``points`` (N, 3) m with ``triangles`` (T, 3) and ``thickness`` (T,) m; ``young`` in Pa."""
    frame, shape = facet_frames(points[triangles])
    length, x3, y3 = shape.T
    zero = np.zeros_like(length)
    x = np.column_stack([zero, length, x3])
    y = np.column_stack([zero, zero, y3])
    plane_stress = (
        young / (1.0 - poisson**2) * np.array([[1.0, poisson, 0.0], [poisson, 1.0, 0.0], [0.0, 0.0, (1 - poisson) / 2]])
    )
    membrane = _membrane(x, y, thickness, plane_stress, poisson)
    kept = np.array([3, 6, 7, 2, 5, 8])  # u_2, u_3, v_3 and the drilling rotations: the other three are rigid
    bending = _bending(x, y, plane_stress) * (thickness**3 / 12.0)[:, None, None]
    return Facets(frame, shape, np.ascontiguousarray(membrane[:, kept[:, None], kept]), bending)


def facet_frames(corners: Array) -> tuple[Array, Array]:
    """Frames (T, 3, 3) and shapes (T, 3) m of facets with ``corners`` (T, 3, 3) m."""
    side = corners[:, 1] - corners[:, 0]
    other = corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(side, axis=1)
    e1 = side / length[:, None]
    normal = np.cross(side, other)
    e3 = normal / np.linalg.norm(normal, axis=1)[:, None]
    e2 = np.cross(e3, e1)
    shape = np.column_stack([length, np.einsum("ti,ti->t", other, e1), np.einsum("ti,ti->t", other, e2)])
    return np.stack([e1, e2, e3], axis=1), shape


def _area(x: Array, y: Array) -> Array:
    return np.asarray(0.5 * ((x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])))


def _membrane(x: Array, y: Array, thickness: Array, plane_stress: Array, poisson: float) -> Array:
    """(T, 9, 9) stiffness of (u, v, drilling) per node: basic part plus three quarters of the scaled higher part."""
    area = _area(x, y)
    lump = np.zeros((len(x), 9, 3))
    hierarchical = np.zeros((len(x), 3, 9))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        y_jk, x_kj = y[:, j] - y[:, k], x[:, k] - x[:, j]
        y_ik, y_ji = y[:, i] - y[:, k], y[:, j] - y[:, i]
        x_ki, x_ij = x[:, k] - x[:, i], x[:, i] - x[:, j]
        lump[:, 3 * i, 0] = lump[:, 3 * i + 1, 2] = y_jk
        lump[:, 3 * i, 2] = lump[:, 3 * i + 1, 1] = x_kj
        lump[:, 3 * i + 2, 0] = _ALPHA / 6 * y_jk * (y_ik - y_ji)
        lump[:, 3 * i + 2, 1] = _ALPHA / 6 * x_kj * (x_ki - x_ij)
        lump[:, 3 * i + 2, 2] = _ALPHA / 3 * (x_ki * y_ik - x_ij * y_ji)
        hierarchical[:, :, 3 * i] = (x_kj / (4 * area))[:, None]
        hierarchical[:, :, 3 * i + 1] = (-y_jk / (4 * area))[:, None]
        hierarchical[:, i, 3 * i + 2] = 1.0
    lump *= 0.5
    scale = (thickness / area)[:, None, None]
    basic = scale * (lump @ plane_stress @ lump.transpose(0, 2, 1))
    higher = _higher_order(x, y, area, plane_stress) * (area * thickness)[:, None, None]
    weight = 0.75 * 0.5 * max(1.0 - 4.0 * poisson**2, 0.01)
    return np.asarray(basic + weight * (hierarchical.transpose(0, 2, 1) @ higher @ hierarchical))


def _higher_order(x: Array, y: Array, area: Array, plane_stress: Array) -> Array:
    """(T, 3, 3) stiffness of the deviatoric drilling angles per area and thickness, from strains along the sides."""
    sides = ((0, 1), (1, 2), (2, 0))  # the sides 21, 32, 13 of the source
    dx = np.stack([x[:, j] - x[:, i] for i, j in sides], axis=1)
    dy = np.stack([y[:, j] - y[:, i] for i, j in sides], axis=1)
    square = dx**2 + dy**2
    along_sides = np.stack([dx**2, dy**2, dx * dy], axis=2) / square[:, :, None]
    to_cartesian = np.linalg.inv(along_sides)
    natural = to_cartesian.transpose(0, 2, 1) @ plane_stress @ to_cartesian
    b1, b2, b3, b4, b5, b6, b7, b8, b9 = _BETA
    rows = (2.0 * area / 3.0)[:, None, None] / square[:, :, None]
    q1 = rows * np.array([[b1, b2, b3], [b4, b5, b6], [b7, b8, b9]])
    q2 = rows * np.array([[b9, b7, b8], [b3, b1, b2], [b6, b4, b5]])
    q3 = rows * np.array([[b5, b6, b4], [b8, b9, b7], [b2, b3, b1]])
    total = np.zeros_like(q1)
    for q in (0.5 * (q1 + q2), 0.5 * (q2 + q3), 0.5 * (q3 + q1)):
        total += q.transpose(0, 2, 1) @ natural @ q
    return total


def _bending(x: Array, y: Array, plane_stress: Array) -> Array:
    """(T, 6, 6) stiffness of the nodal rotations times 12 / thickness^3, corner deflections being zero.

    The fibre rotation b = (theta_y, -theta_x) is quadratic over the facet. At the middle of a side with unit tangent
    t the Kirchhoff condition along the side and a linear normal part give b = (I/2 - 3/4 t t') (b_i + b_j).
    """
    area = _area(x, y)
    # area coordinates and their constant gradients (T, 3)
    gx = np.stack([y[:, (i + 1) % 3] - y[:, (i + 2) % 3] for i in range(3)], axis=1) / (2 * area)[:, None]
    gy = np.stack([x[:, (i + 2) % 3] - x[:, (i + 1) % 3] for i in range(3)], axis=1) / (2 * area)[:, None]
    middle = []
    for i in range(3):
        j = (i + 1) % 3
        t = np.stack([x[:, j] - x[:, i], y[:, j] - y[:, i]], axis=1)
        t /= np.linalg.norm(t, axis=1)[:, None]
        middle.append(0.5 * np.eye(2) - 0.75 * t[:, :, None] * t[:, None, :])
    to_fibre = np.array([[0.0, 1.0], [-1.0, 0.0]])
    stiffness = np.zeros((len(x), 6, 6))
    for place in ((0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5)):  # exact for the quadratic integrand
        curvature = np.zeros((len(x), 3, 6))
        for node in range(3):
            slope = 4.0 * place[node] - 1.0
            fibre_x = slope * gx[:, node, None, None] * np.eye(2)  # d b / d x by b of this node
            fibre_y = slope * gy[:, node, None, None] * np.eye(2)
            for side in (node, (node + 2) % 3):
                i, j = side, (side + 1) % 3
                fibre_x = fibre_x + 4 * (place[i] * gx[:, j] + place[j] * gx[:, i])[:, None, None] * middle[side]
                fibre_y = fibre_y + 4 * (place[i] * gy[:, j] + place[j] * gy[:, i])[:, None, None] * middle[side]
            fibre_x, fibre_y = fibre_x @ to_fibre, fibre_y @ to_fibre
            curvature[:, 0, 2 * node : 2 * node + 2] = fibre_x[:, 0]
            curvature[:, 1, 2 * node : 2 * node + 2] = fibre_y[:, 1]
            curvature[:, 2, 2 * node : 2 * node + 2] = fibre_y[:, 0] + fibre_x[:, 1]
        stiffness += (area / 3.0)[:, None, None] * (curvature.transpose(0, 2, 1) @ plane_stress @ curvature)
    return stiffness
