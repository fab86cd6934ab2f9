"""Level sections of a triangle mesh: closed loops linked through shared edges.

Rule for what lies exactly on a level: a vertex at the level counts as below it. A facet is cut when it has vertices
on both sides, so a facet that lies in the level is never cut, an edge in the level is cut by the facet above it only,
and every cut facet has exactly two cut edges. On a surface without free edges all loops are therefore closed, whatever
the level; a chain that ends at a free edge (or at an edge of three facets) is told apart.

Loops have the lower ground on their left: seen from above, pockets run counter-clockwise and islands clockwise.
Segments are linked by the edge they share, never by the distance of points. The work grows with the number of facets
plus the number of cuts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Array, Indices
from numpy.typing import NDArray

from isf_planner.jit import kernel
from isf_planner.part.meshes import Mesh


@dataclass(frozen=True)
class MeshLoop:
    """A section line at one level.

    Attributes
    ----------
    level : m ; points : (N, 2) m, first point not repeated ; closed : False when it ends at a free edge
    """

    level: float
    points: Array
    closed: bool

    @property
    def area(self) -> float:
        """m^2, positive around lower ground."""
        x, y = self.points.T
        return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def slice_mesh(mesh: Mesh, levels: Array) -> list[list[MeshLoop]]:
    """Loops of the ``mesh`` at every one of ``levels`` (K,) m, in any order; one list per level.

    The mesh may have any number of components and free edges; its facets must be oriented alike.
    """
    order = np.argsort(levels)
    rising = np.asarray(levels, dtype=np.float64)[order]
    points, starts, level_of, closed = _loops(mesh.vertices, mesh.faces, rising)
    found: list[list[MeshLoop]] = [[] for _ in levels]
    for loop in range(len(level_of)):
        k = level_of[loop]
        line = points[starts[loop] : starts[loop + 1]]
        found[order[k]].append(MeshLoop(float(rising[k]), line, bool(closed[loop])))
    return found


def _loops(vertices: Array, faces: Indices, levels: Array) -> tuple[Array, Indices, Indices, NDArray[np.bool_]]:
    z = np.ascontiguousarray(vertices[:, 2])
    begin, facet = _cuts(z, faces, levels)
    return _link(np.ascontiguousarray(vertices), faces, levels, begin, facet)


@kernel
def _cuts(z: Array, faces: Indices, levels: Array) -> tuple[Indices, Indices]:
    """Facets cut by every level: offsets (K + 1,) into the facets (S,)."""
    count = np.zeros(len(levels) + 1, dtype=np.int64)
    for f in range(len(faces)):
        a, b, c = z[faces[f, 0]], z[faces[f, 1]], z[faces[f, 2]]
        low, high = min(a, b, c), max(a, b, c)
        if high > levels[0] and low <= levels[-1]:
            for k in range(np.searchsorted(levels, low), np.searchsorted(levels, high)):
                count[k + 1] += 1
    begin = np.cumsum(count)
    place = begin[:-1].copy()
    facet = np.empty(begin[-1], dtype=np.int64)
    for f in range(len(faces)):
        a, b, c = z[faces[f, 0]], z[faces[f, 1]], z[faces[f, 2]]
        low, high = min(a, b, c), max(a, b, c)
        if high > levels[0] and low <= levels[-1]:
            for k in range(np.searchsorted(levels, low), np.searchsorted(levels, high)):
                facet[place[k]] = f
                place[k] += 1
    return begin, facet


@kernel
def _link(
    vertices: Array, faces: Indices, levels: Array, begin: Indices, facet: Indices
) -> tuple[Array, Indices, Indices, NDArray[np.bool_]]:
    """Points (P, 2), starts (L + 1,), level (L,) and closed (L,) of all loops."""
    total = len(facet)
    points = np.empty((total + len(facet), 2))
    starts = np.empty(total + 1, dtype=np.int64)
    level_of = np.empty(total, dtype=np.int64)
    closed = np.empty(total, dtype=np.bool_)
    loops, used = 0, 0
    most = 0
    for k in range(len(levels)):
        most = max(most, begin[k + 1] - begin[k])
    size = 16
    while size < 2 * most:
        size *= 2
    keys = np.empty(size, dtype=np.int64)
    owner = np.empty(size, dtype=np.int64)
    stamp = np.full(size, -1, dtype=np.int64)
    entry = np.empty((most, 2), dtype=np.int64)
    leave = np.empty((most, 2), dtype=np.int64)
    following = np.empty(most, dtype=np.int64)
    preceded = np.empty(most, dtype=np.bool_)
    done = np.empty(most, dtype=np.bool_)
    number = len(vertices)
    for k in range(len(levels)):
        level, first, n = levels[k], begin[k], begin[k + 1] - begin[k]
        for i in range(n):
            f = facet[first + i]
            for c in range(3):
                p, q = faces[f, c], faces[f, (c + 1) % 3]
                below_p, below_q = vertices[p, 2] <= level, vertices[q, 2] <= level
                if below_p and not below_q:
                    entry[i, 0], entry[i, 1] = p, q
                elif below_q and not below_p:
                    leave[i, 0], leave[i, 1] = p, q
            preceded[i] = False
            done[i] = False
            key = min(entry[i, 0], entry[i, 1]) * number + max(entry[i, 0], entry[i, 1])
            slot = (key * -7046029254386353131 >> 20) & (size - 1)
            while stamp[slot] == k and keys[slot] != key:
                slot = (slot + 1) & (size - 1)
            # two facets that are entered through one edge: the chain cannot go on there
            owner[slot] = -1 if stamp[slot] == k else i
            stamp[slot], keys[slot] = k, key
        for i in range(n):
            key = min(leave[i, 0], leave[i, 1]) * number + max(leave[i, 0], leave[i, 1])
            slot = (key * -7046029254386353131 >> 20) & (size - 1)
            while stamp[slot] == k and keys[slot] != key:
                slot = (slot + 1) & (size - 1)
            following[i] = owner[slot] if stamp[slot] == k else -1
            if following[i] >= 0:
                if preceded[following[i]]:
                    following[i] = -1
                else:
                    preceded[following[i]] = True
        for turn in range(2):  # chains with an end first, what is left then is closed
            for i in range(n):
                if done[i] or (turn == 0 and preceded[i]):
                    continue
                starts[loops], level_of[loops], closed[loops] = used, k, turn == 1
                j = i
                last = i
                while j >= 0 and not done[j]:
                    done[j] = True
                    _cross(vertices, entry[j, 0], entry[j, 1], level, points, used)
                    used += 1
                    last = j
                    j = following[j]
                if turn == 0:
                    _cross(vertices, leave[last, 0], leave[last, 1], level, points, used)
                    used += 1
                loops += 1
    starts[loops] = used
    return points[:used].copy(), starts[: loops + 1].copy(), level_of[:loops].copy(), closed[:loops].copy()


@kernel
def _cross(vertices: Array, a: int, b: int, level: float, points: Array, row: int) -> None:
    """Where edge a-b meets the level; from the lower index, so that both facets give the same point."""
    p, q = min(a, b), max(a, b)
    share = (level - vertices[p, 2]) / (vertices[q, 2] - vertices[p, 2])
    points[row, 0] = vertices[p, 0] + share * (vertices[q, 0] - vertices[p, 0])
    points[row, 1] = vertices[p, 1] + share * (vertices[q, 1] - vertices[p, 1])
