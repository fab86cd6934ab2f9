"""Curvature of a sampled surface over a length of our choice, the same for facets, fillets, sharp edges and noise.

Every edge of the facets carries the curvature measure beta |e| e e^T (beta: signed angle between its facets, e: unit
vector along it), which turns into the second fundamental form, with its directions exchanged, when it is summed over
a piece of surface and divided by its area (normal cycle, Cohen-Steiner 2003). Here the sum is a diffusion along the
surface, (M + l^2 K) H = sum of measures, with the areas M and the cotangent stiffness K: a mean with the weight
exp(-s/l) over the distance s. So a sharp edge of angle beta is a curvature of up to beta / (2 l), a fillet of radius r
much wider than l one of 1/r, and the chamfers of a coarse mesh add up to the surface they stand for.

Against noise the normals of the facets are first averaged over their neighbours, each with a weight that falls with the
angle between the two (:data:`ALIKE`): what is a plane or bends slowly is smoothed, what is an edge stays one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices, Mask
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

ALIKE = 0.15
"""rad; normals that differ by more hardly count as of one surface."""

REACH = 2
"""Cells around a facet over which its normal is averaged."""

ROUNDS = 2
"""How often."""


@dataclass(frozen=True)
class Curvature:
    """Of N nodes of a grid, in their order; of nodes that were left out all is zero.

    Attributes
    ----------
    largest, second : (N,) 1/m, principal curvatures, the one of larger size first; positive where concave from above
    ridge : (N, 3) unit, direction of the second one: along an edge, a fillet, a ruling
    normal : (N, 3) unit, upwards, averaged in the same way
    area : (N,) m^2, surface that belongs to the node
    """

    largest: Array
    second: Array
    ridge: Array
    normal: Array
    area: Array


def curvature(heights: HeightMap, length: float, used: Mask | None = None) -> Curvature:
    """Curvature of a surface over ``length`` m; nothing crosses from nodes that are not ``used`` (ny, nx)."""
    facets = _Facets.of(heights, np.ones(heights.z.shape, dtype=np.bool_) if used is None else used)
    measure = facets.measures()
    total = facets.area
    known = np.flatnonzero(total > 0.0)
    stiffness = facets.stiffness()[known][:, known]
    mass = csc_matrix((total[known], (np.arange(len(known)), np.arange(len(known)))))
    right = np.column_stack([measure, facets.normal_sums()])[known]
    smooth = np.zeros((len(total), right.shape[1]))
    factor = splu((mass + length**2 * stiffness).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    smooth[known] = factor.solve(np.ascontiguousarray(right))
    normal = smooth[:, 6:]
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    return Curvature(*_principal(smooth[:, :6]), normal, total)


def _principal(form: Array) -> tuple[Array, Array, Array]:
    """Larger and smaller principal curvature, and the direction of the smaller, of forms xx, yy, zz, xy, yz, zx."""
    matrix = form[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
    value, vector = np.linalg.eigh(matrix)
    order = np.argsort(-np.abs(value), axis=1)
    rows = np.arange(len(form))
    # the directions of the measure are exchanged: across an edge it bends, along it points the vector
    return value[rows, order[:, 0]], value[rows, order[:, 1]], vector[rows, :, order[:, 0]]


@dataclass(frozen=True)
class _Facets:
    """The facets of the grid whose corners are all used; two per cell, a-b-c and a-c-d, counter-clockwise.

    Attributes
    ----------
    faces : (F, 3) nodes ; normal : (F, 3) unit ; size : (F,) m^2 ; points : (N, 3) m
    area : (N,) m^2 of every node ; edges : (E, 4) nodes of an edge, and the facets left and right of it
    """

    faces: Indices
    normal: Array
    size: Array
    points: Array
    area: Array
    edges: Indices

    @staticmethod
    def of(heights: HeightMap, used: Mask) -> _Facets:
        points, shape = heights.points(), heights.z.shape
        node = np.arange(heights.z.size).reshape(shape)
        a, b, c, d = node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]
        lower, upper = np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)
        number = np.full((2, *a.shape), -1)
        inside = used.ravel()
        whole = np.array([inside[lower].all(axis=-1), inside[upper].all(axis=-1)])
        number[whole] = np.arange(np.count_nonzero(whole))
        faces = np.vstack([lower[whole[0]], upper[whole[1]]])
        corners = points[faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double = np.linalg.norm(across, axis=1)
        area = np.bincount(faces.ravel(), np.repeat(double / 6.0, 3), heights.z.size)
        # edges along x: the facet a-b-c above on their left, a-c-d of the cell below on their right; and so on
        pieces = [
            np.stack([a[1:], b[1:], number[0, 1:], number[1, :-1]], axis=-1),
            np.stack([a[:, 1:], d[:, 1:], number[0, :, :-1], number[1, :, 1:]], axis=-1),
            np.stack([a, c, number[1], number[0]], axis=-1),
        ]
        edges = np.vstack([piece.reshape(-1, 4) for piece in pieces])
        edges = edges[(edges[:, 2:] >= 0).all(axis=1)]
        normal, size = np.zeros((*number.shape, 3)), np.zeros(number.shape)
        normal[whole], size[whole] = across / np.maximum(double, 1e-30)[:, None], 0.5 * double
        for _ in range(ROUNDS):
            normal = _averaged(normal, size)
        return _Facets(faces, normal[whole], 0.5 * double, points, area, edges)

    def measures(self) -> Array:
        """(N, 6) m, curvature measures of the edges at every node: xx, yy, zz, xy, yz, zx."""
        first, second, left, right = self.edges.T
        way = self.points[second] - self.points[first]
        length = np.linalg.norm(way, axis=1)
        unit = way / length[:, None]
        sine = -(unit * np.cross(self.normal[left], self.normal[right])).sum(axis=1)
        beta = np.arctan2(sine, (self.normal[left] * self.normal[right]).sum(axis=1))
        x, y, z = unit.T
        values = 0.5 * (beta * length)[:, None] * np.column_stack([x * x, y * y, z * z, x * y, y * z, z * x])
        return self._gathered(np.concatenate([first, second]), np.vstack([values, values]))

    def normal_sums(self) -> Array:
        """(N, 3) m^2, facet normals by area."""
        return self._gathered(self.faces.ravel(), np.repeat(self.normal * self.size[:, None] / 3.0, 3, axis=0))

    def stiffness(self) -> csc_matrix:
        """(N, N) cotangent stiffness of the surface, a Laplacian with the area factored out."""
        rows, columns, values = [], [], []
        for k in range(3):
            i, j, o = self.faces[:, k], self.faces[:, (k + 1) % 3], self.faces[:, (k + 2) % 3]
            u, v = self.points[i] - self.points[o], self.points[j] - self.points[o]
            half = 0.25 * (u * v).sum(axis=1) / np.maximum(self.size, 1e-30)  # half the cotangent at o
            rows += [i, j, i, j]
            columns += [j, i, i, j]
            values += [-half, -half, half, half]
        count = len(self.points)
        return csc_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(count, count)
        )

    def _gathered(self, nodes: Indices, values: Array) -> Array:
        count = len(self.points)
        return np.column_stack([np.bincount(nodes, values[:, k], count) for k in range(values.shape[1])])


def _averaged(normal: Array, size: Array) -> Array:
    """(2, ny, nx, 3) unit normals of the two facets of every cell, averaged over those alike around them.

    ``size`` (2, ny, nx) m^2 of the facets, 0 where there is none.
    """
    # facets of one kind alone: the middles of both kinds together lie elsewhere than that of the facet
    reach = ((0, 0), (REACH, REACH), (REACH, REACH))
    around, weight = np.pad(normal, (*reach, (0, 0))), np.pad(size, reach)
    rows, columns = size.shape[1:]
    total = np.zeros_like(normal)
    for row in range(2 * REACH + 1):
        for column in range(2 * REACH + 1):
            window = np.s_[:, row : row + rows, column : column + columns]
            apart = 2.0 - 2.0 * np.einsum("kijc,kijc->kij", normal, around[window])
            total += (np.exp(-0.5 * apart / ALIKE**2) * weight[window])[..., None] * around[window]
    return total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-30)
