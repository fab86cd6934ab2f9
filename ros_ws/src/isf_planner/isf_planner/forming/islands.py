"""Islands on a plane floor, taken out of a part to be formed from its other side (Praveen 2020, 3.2.1.1).

A part is split by planes parallel to the sheet. An island that rises from the plane floor of a pocket is no part of
the pocket then: the pocket is formed with its floor complete, and the floor is the flange of what rises from it, which
the other tool forms. The same holds for a hollow in a plateau above the flange, and for what stands in an island. Only
edges of the mesh bound a floor, so nothing is cut and every vertex keeps its place in x and y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Indices
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from isf_planner.part.meshes import Mesh, Topology, topology
from isf_planner.surface import target_surface

FLAT = 1e-3
"""rad, facets less inclined belong to a floor: 4 nm below the end of a fillet of 8 mm, ten times what single precision
leaves of the inclination of a facet 0.1 mm wide."""

LEVEL = 50e-9
"""m, so do facets that rise by less, however narrow they are."""

UNEVEN = 20e-6
"""m, largest difference in height within a floor; more is a slope."""

RISES = 0.05e-3
"""m, from which something on a floor is a feature."""


@dataclass(frozen=True)
class Island:
    """What stands on a floor: ``mesh`` is the whole part with everything else at the height of the floor, which is 0;
    ``level`` m, height of the floor over the flange of the part."""

    mesh: Mesh
    level: float


def taken_out(mesh: Mesh, flange: float) -> tuple[Mesh, tuple[Island, ...]]:
    """The part with its outermost islands levelled to their floors, and these islands.

    Parameters
    ----------
    mesh : one connected height field with an outline
    flange : m, z of the outline
    """
    vertices = mesh.vertices.copy()
    found = []
    for facets, level in _islands(mesh, flange):
        inside = np.zeros(len(vertices), dtype=np.bool_)
        inside[mesh.faces[facets]] = True
        alone = vertices.copy()
        alone[:, 2] = np.where(inside, vertices[:, 2] - level, 0.0)
        vertices[inside, 2] = level
        found.append(Island(mesh.with_vertices(alone), level - flange))
    return (mesh.with_vertices(vertices) if found else mesh), tuple(found)


def _islands(mesh: Mesh, flange: float) -> list[tuple[Indices, float]]:
    """Facets of every outermost island, largest first, and the height (m) of its floor."""
    edges = topology(mesh)
    regions = _Regions.of(mesh, edges)
    outside = np.unique(regions.label[edges.facets[edges.free, 0]])
    if len(outside) == 0:
        return []
    found: list[tuple[Indices, float]] = []
    for floor in np.flatnonzero(regions.floor & (regions.neighbours() > 1)):
        z = mesh.vertices[mesh.faces[regions.label == floor].ravel(), 2]
        level = float(np.median(z))
        if floor in outside or np.ptp(z) > UNEVEN or abs(level - flange) < RISES:
            continue
        for inner in regions.cut_off_by(int(floor), outside):
            facets = np.flatnonzero(np.isin(regions.label, inner))
            if _turns_back(mesh, edges, regions.label == floor, facets, level, level < flange):
                found.append((facets, level))
    found.sort(key=lambda island: -len(island[0]))
    taken = np.zeros(len(mesh.faces), dtype=np.bool_)
    outermost = []
    for facets, level in found:
        if not taken[facets[0]]:
            outermost.append((facets, level))
            taken[facets] = True
    return outermost


def _turns_back(
    mesh: Mesh, edges: Topology, floor: NDArray[np.bool_], facets: Indices, level: float, pocket: bool
) -> bool:
    """What stands on the floor goes back to the flange where it begins: up in a pocket, down on a plateau.

    What goes on away from the flange, a step in the floor, is the pocket's own.
    """
    sign = 1.0 if pocket else -1.0
    inside = np.zeros(len(mesh.faces), dtype=np.bool_)
    inside[facets] = True
    pairs = edges.facets[edges.count == 2]
    first, second = pairs[:, 0], pairs[:, 1]
    beginning = np.concatenate([first[inside[first] & floor[second]], second[inside[second] & floor[first]]])
    rise = sign * (mesh.vertices[mesh.faces[beginning].ravel(), 2] - level)
    most = sign * (mesh.vertices[mesh.faces[facets].ravel(), 2] - level)
    return bool(rise.max(initial=0.0) > -rise.min(initial=0.0) and most.max() > RISES)


@dataclass(frozen=True)
class _Regions:
    """A mesh as floors and what lies between them: ``label`` (F,) region of every facet, ``floor`` (G,) whether a
    region is flat, ``joined`` (K, 2) pairs of neighbouring regions, each once."""

    label: Indices
    floor: NDArray[np.bool_]
    joined: Indices

    @staticmethod
    def of(mesh: Mesh, edges: Topology) -> _Regions:
        rises = np.ptp(mesh.vertices[:, 2][mesh.faces], axis=1)
        flat = (target_surface.facet_normals(mesh)[:, 2] > np.cos(FLAT)) | (rises < LEVEL)
        pairs = edges.facets[edges.count == 2]
        same = flat[pairs[:, 0]] == flat[pairs[:, 1]]
        count, label = _connected(pairs[same], len(mesh.faces))
        floor = np.zeros(count, dtype=np.bool_)
        floor[label] = flat
        return _Regions(label, floor, np.unique(np.sort(label[pairs[~same]], axis=1), axis=0))

    def neighbours(self) -> Indices:
        """(G,) how many regions each one borders on."""
        return np.bincount(self.joined.ravel(), minlength=len(self.floor))

    def cut_off_by(self, floor: int, outside: Indices) -> list[Indices]:
        """Regions that can be reached from ``outside`` over the ``floor`` only, those that hang together in one."""
        _, part = _connected(self.joined[(self.joined != floor).all(axis=1)], len(self.floor))
        inner = np.setdiff1d(np.unique(part), np.append(part[outside], part[floor]))
        return [np.flatnonzero(part == k) for k in inner]


def _connected(pairs: Indices, count: int) -> tuple[int, Indices]:
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (count, count))
    number, label = connected_components(graph, directed=False)
    return int(number), np.asarray(label, dtype=np.int64)
