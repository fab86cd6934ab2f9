"""Edges of a triangle mesh and what they join: free edges, edges of more than two facets, contradicting facets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from isf_planner.jit import kernel
from isf_planner.mesh_input import Mesh

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LONG_ROW = 48
"""Edges that start at one vertex are compared pairwise; more than this many are sorted first."""


@dataclass(frozen=True)
class Topology:
    """E edges of a mesh with F facets.

    Attributes
    ----------
    vertices : (E, 2) vertex indices, the lower first
    facets : (E, 2) the first two facets at the edge, -1 where there is none
    count : (E,) facets at the edge
    forward : (E,) how many of them run through it from the lower to the higher vertex
    """

    vertices: Indices
    facets: Indices
    count: Indices
    forward: Indices

    @property
    def free(self) -> Indices:
        """Edges of one facet only."""
        return np.flatnonzero(self.count == 1)

    @property
    def crowded(self) -> Indices:
        """Edges of three and more facets: the mesh is no surface there."""
        return np.flatnonzero(self.count > 2)

    @property
    def contradicting(self) -> Indices:
        """Edges whose two facets are oriented against each other."""
        return np.flatnonzero((self.count == 2) & (self.forward != 1))

    def free_loops(self) -> list[Indices]:
        """Vertex indices of every connected set of free edges."""
        edges = self.vertices[self.free]
        if len(edges) == 0:
            return []
        vertices, local = np.unique(edges, return_inverse=True)
        local = local.reshape(edges.shape)
        graph = coo_matrix((np.ones(len(edges)), (local[:, 0], local[:, 1])), shape=(len(vertices), len(vertices)))
        _, label = connected_components(graph, directed=False)
        order = np.argsort(label, kind="stable")
        return [vertices[part] for part in np.split(order, np.flatnonzero(np.diff(label[order])) + 1)]

    def components(self, facets: int) -> tuple[int, Indices]:
        """Number of parts that hang together by edges, and the part (F,) of every facet; ``facets``: F."""
        joined = self.facets[self.count >= 2]
        ones = np.ones(len(joined))
        return connected_components(coo_matrix((ones, (joined[:, 0], joined[:, 1])), (facets, facets)), directed=False)


def topology(mesh: Mesh) -> Topology:
    """Edges of the ``mesh``; the work grows with the number of facets and is done once for the same faces."""
    known = mesh.derived.get("topology")
    if not isinstance(known, Topology):
        known = Topology(*_edges(np.ascontiguousarray(mesh.faces), len(mesh.vertices)))
        mesh.derived["topology"] = known
    return known


@kernel
def _edges(faces: Indices, vertices: int) -> tuple[Indices, Indices, Indices, Indices]:
    begin = np.zeros(vertices + 1, dtype=np.int64)
    for f in range(len(faces)):
        for c in range(3):
            begin[min(faces[f, c], faces[f, (c + 1) % 3]) + 1] += 1
    begin = np.cumsum(begin)
    place = begin[:-1].copy()
    high = np.empty(3 * len(faces), dtype=np.int64)
    half = np.empty(3 * len(faces), dtype=np.int64)
    for f in range(len(faces)):
        for c in range(3):
            p, q = faces[f, c], faces[f, (c + 1) % 3]
            slot = place[min(p, q)]
            place[min(p, q)] += 1
            high[slot], half[slot] = max(p, q), 3 * f + c
    pairs = np.empty((3 * len(faces), 2), dtype=np.int64)
    facets = np.full((3 * len(faces), 2), -1, dtype=np.int64)
    count = np.zeros(3 * len(faces), dtype=np.int64)
    forward = np.zeros(3 * len(faces), dtype=np.int64)
    edges = 0
    for low in range(vertices):
        first, last = begin[low], begin[low + 1]
        if last - first > _LONG_ROW:
            order = np.argsort(high[first:last])
            high[first:last] = high[first:last][order]
            half[first:last] = half[first:last][order]
        base = edges
        for slot in range(first, last):
            edge = -1
            start = max(base, edges - 1) if last - first > _LONG_ROW else base
            for other in range(start, edges):
                if pairs[other, 1] == high[slot]:
                    edge = other
                    break
            if edge < 0:
                edge = edges
                edges += 1
                pairs[edge, 0], pairs[edge, 1] = low, high[slot]
            f, c = half[slot] // 3, half[slot] % 3
            if count[edge] < 2:
                facets[edge, count[edge]] = f
            count[edge] += 1
            if faces[f, c] == low:
                forward[edge] += 1
    return pairs[:edges].copy(), facets[:edges].copy(), count[:edges].copy(), forward[:edges].copy()
