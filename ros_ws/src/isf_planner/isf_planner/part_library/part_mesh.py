"""The mesh of a library part: rings along the wall profile of every feature, flat faces between them.

Rings lie on the exact surface; facets deviate from it by the chord errors around and down the wall. Flat faces are
Delaunay triangulations of what lies between rings, checked to hold every ring edge exactly once.
"""

from __future__ import annotations

import numpy as np
import shapely
from isf_core.types import Array, Indices
from scipy.spatial import Delaunay

from isf_planner.part.meshes import Mesh
from isf_planner.part_library.part import STRAIGHT_STEP, Feature, Part, segments

FLAT_STEP = 8e-3
"""m, pitch of the extra nodes in flat faces."""


def part_mesh(part: Part, chord: float = 2e-6) -> Mesh:
    """Upper face as triangles, normals up.

    Parameters
    ----------
    part : from the catalogue or composed
    chord : m, largest distance of a facet's edge from an arc; facets of doubly curved fillets may be twice as far

    Raises
    ------
    ValueError : features touch each other, or a corner radius is smaller than the wall is wide
    """
    nested = part.outline is None
    vertices: list[Array] = []
    faces: list[Indices] = []
    outer: list[Indices] = []
    inner: list[Indices] = []
    count = 0
    for k, feature in enumerate(part.features):
        flange = part.flange if nested and k == 0 else 0.0
        base = -part.features[0].profile.depth if nested and k > 0 else 0.0
        rings, heights = _rings(feature, flange, chord)
        size = len(rings[0])
        level = np.repeat(base + np.array(heights), size)
        vertices.append(np.column_stack([np.vstack(rings), level]))
        faces.append(count + _strips(len(rings), size))
        outer.append(count + np.arange(size))
        inner.append(count + (len(rings) - 1) * size + np.arange(size))
        count += len(rings) * size
    flats: list[tuple[list[Indices], float]] = []
    if nested:
        flats.append(([inner[0], *outer[1:]], -part.features[0].profile.depth))
        tops = range(1, len(part.features))
    else:
        rim = _rectangle(part.outline or (0.0, 0.0))
        vertices.append(np.column_stack([rim, np.zeros(len(rim))]))
        flats.append(([count + np.arange(len(rim)), *outer], 0.0))
        count += len(rim)
        tops = range(len(part.features))
    points = np.vstack(vertices)
    flats += [([inner[k]], float(points[inner[k][0], 2])) for k in tops]
    for rings_of, z in flats:
        extra, triangles = _flat(points[:, :2], rings_of)
        triangles = np.where(triangles >= 0, triangles, len(points) - 1 - triangles)
        points = np.vstack([points, np.column_stack([extra, np.full(len(extra), z)])])
        faces.append(triangles)
    points[:, :2] -= part.origin
    return Mesh(points, np.vstack(faces).astype(np.int64))


def _rings(feature: Feature, flange: float, chord: float) -> tuple[list[Array], list[float]]:
    """Lines (M, 2) m around the feature from the flange to the floor, and their heights m."""
    profile, chain = feature.profile, feature.profile.chain
    sign = -1.0 if feature.up else 1.0
    span = (profile.first - flange, profile.last)
    d, z = [], []
    for k, (curvature, length) in enumerate(zip(chain.curvature, chain.length, strict=True)):
        count = segments(1.0 / abs(curvature), float(length * abs(curvature)), chord) if curvature else 2
        points, _ = chain.at(np.full(count, k), length * np.arange(count) / count)
        d += points[:, 0].tolist()
        z += points[:, 1].tolist()
    d.append(profile.last)
    z.append(-profile.depth)
    if flange > 0.0:
        d.insert(0, profile.first - flange)
        z.insert(0, 0.0)
    rings = [feature.levels.ring(value, chord, span) for value in d]
    for ring in (rings[0], rings[-1]):
        if not shapely.Polygon(ring).is_valid or _turns_back(rings[0], ring):
            raise ValueError(
                "walls or flange are wider than the corner radius allows: a larger opening or radius, steeper walls"
            )
    return rings, [sign * value for value in z]


def _turns_back(first: Array, ring: Array) -> bool:
    """True where an edge of ``ring`` runs against the edge of ``first`` it belongs to."""
    a, b = np.roll(first, -1, axis=0) - first, np.roll(ring, -1, axis=0) - ring
    return bool(((a * b).sum(axis=1) <= 0.0).any())


def _strips(rings: int, size: int) -> Indices:
    """Triangles between rings from the outside inwards."""
    index, following = np.arange(size), (np.arange(size) + 1) % size
    faces = []
    for k in range(rings - 1):
        a, b = k * size, (k + 1) * size
        faces += [
            np.column_stack([a + index, a + following, b + following]),
            np.column_stack([a + index, b + following, b + index]),
        ]
    return np.vstack(faces)


def _rectangle(half: tuple[float, float]) -> Array:
    """(M, 2) m, counter-clockwise outline with edges of about 4 mm."""
    corners = np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]) * np.asarray(half)
    sides = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = int(np.ceil(np.linalg.norm(b - a) / STRAIGHT_STEP))
        sides.append(a + (b - a) * (np.arange(count) / count)[:, None])
    return np.vstack(sides)


def _flat(points: Array, rings: list[Indices]) -> tuple[Array, Indices]:
    """Nodes (E, 2) m and triangles (T, 3) of the face inside ``rings[0]`` and outside the others.

    Corners of a triangle are indices into ``points``, or -1 - k for the new node k.
    """
    known = np.concatenate(rings)
    face = shapely.Polygon(points[rings[0]], [points[ring] for ring in rings[1:]])
    if not face.is_valid:
        raise ValueError("features touch each other or the outline")
    low, high = points[rings[0]].min(axis=0), points[rings[0]].max(axis=0)
    pitch = min(FLAT_STEP, float((high - low).min()) / 4.0)
    axes = [np.arange(a + pitch / 2, b, pitch) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    # half a cell off a square grid: no four nodes on one circle
    grid[:, 0] += 0.37 * pitch * np.sin(grid[:, 1] / pitch)
    core = face.buffer(-0.4 * pitch)
    grid = grid[shapely.contains_xy(core, grid)] if not core.is_empty else np.empty((0, 2))
    if len(grid) == 0:
        grid = np.array([face.representative_point().coords[0]])
    nodes = np.vstack([points[known], grid])
    triangles = Delaunay(nodes).simplices
    corners = nodes[triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    triangles = np.where((area < 0)[:, None], triangles[:, ::-1], triangles)
    inside = shapely.contains_xy(face, corners.mean(axis=1)) & (np.abs(area) > 1e-16)
    triangles = triangles[inside]
    _check_rings(triangles, rings, len(known))
    label = np.concatenate([known, -1 - np.arange(len(grid))])
    return grid, np.asarray(label[triangles])


def _check_rings(triangles: Indices, rings: list[Indices], count: int) -> None:
    """Every edge of the rings, and no other, belongs to one triangle only."""
    edges = np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, times = np.unique(edges, axis=0, return_counts=True)
    free = {tuple(edge) for edge in unique[times == 1].tolist()}
    wanted = set()
    first = 0
    for ring in rings:
        index = first + np.arange(len(ring))
        wanted |= {tuple(edge) for edge in np.sort(np.column_stack([index, np.roll(index, -1)]), axis=1).tolist()}
        first += len(ring)
    if free != wanted or first != count:
        raise ValueError("a flat face could not be meshed: features are too close to each other")
