"""The target surface on regular grids: facets rasterised to heights and smooth normals.

Two uses: a fine grid over the formed region, on which the tool is dropped (:mod:`isf_planner.tip_surface`), and
the 1 mm height map over the whole clamp that is published and compared with scans. Where there is no facet the
sheet is flat: z = 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.height_map import HeightMap
from numpy.typing import NDArray

from isf_planner.mesh_checks import place_text
from isf_planner.mesh_input import Mesh
from isf_planner.surface_normals import corner_normals

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MAP_PITCH = 1e-3
"""m, pitch of the height map over the clamp."""

CELLS_PER_RADIUS = 50
"""Fine grid: cells per tool radius. The height of a ball dropped on samples is then right to R/40000 at a wall
of 50 deg (error cells^-2 / (8 cos(50 deg)^3)): 0.2 um per mm of radius."""

LARGEST_GRID = 2500
"""Most cells of the fine grid along one side; a larger part gets a coarser grid."""

OVERLAP_TOLERANCE = 20e-6
"""m, two heights at one place that differ more are two layers."""

_CHUNK = 1_000_000


@dataclass(frozen=True)
class TargetSurface:
    """Heights and normals on a regular grid in frame ``sheet``.

    Attributes
    ----------
    origin : (2,) m, x and y of node (0, 0)
    pitch : m
    z : (ny, nx) m
    normal_xy : (ny, nx, 2) horizontal part of the unit upward normal of the smooth surface
    """

    origin: Array
    pitch: float
    z: Array
    normal_xy: Array

    @property
    def x(self) -> Array:
        """(nx,) m."""
        return np.asarray(self.origin[0] + self.pitch * np.arange(self.z.shape[1]))

    @property
    def y(self) -> Array:
        """(ny,) m."""
        return np.asarray(self.origin[1] + self.pitch * np.arange(self.z.shape[0]))


def fine_surface(mesh: Mesh, radius: float) -> TargetSurface:
    """Target around the formed region, fine enough for a ball of ``radius`` m.

    The grid reaches 1.5 radii beyond everything that lies below the flange, so that a ball over the formed
    region never leaves it.

    Raises
    ------
    IsfError : MESH_NOT_HEIGHT_FIELD where two layers lie over each other
    """
    corners = mesh.corners()
    formed = corners[(corners[:, :, 2] < -1e-6).any(axis=1)]
    low = formed[:, :, :2].min(axis=(0, 1)) - 1.5 * radius
    high = formed[:, :, :2].max(axis=(0, 1)) + 1.5 * radius
    pitch = max(radius / CELLS_PER_RADIUS, float((high - low).max()) / LARGEST_GRID)
    shape = tuple(int(n) for n in np.ceil((high - low) / pitch)[::-1] + 1)
    z = np.zeros(shape)
    normal_xy = np.zeros((*shape, 2))
    covered = np.zeros(shape, dtype=bool)
    normals = corner_normals(mesh)
    for facet, row, column, weight in _samples(corners[:, :, :2], low, pitch, (shape[0], shape[1])):
        height = np.einsum("kc,kc->k", weight, corners[facet, :, 2])
        before = covered[row, column] & (np.abs(z[row, column] - height) > OVERLAP_TOLERANCE)
        z[row, column] = height
        twice = before | (np.abs(z[row, column] - height) > OVERLAP_TOLERANCE)
        if twice.any():
            k = int(np.argmax(twice))
            _refuse_layers(np.array([low[0] + pitch * column[k], low[1] + pitch * row[k], height[k]]))
        normal = np.einsum("kc,kcd->kd", weight, normals[facet])
        normal_xy[row, column] = normal[:, :2] / np.linalg.norm(normal, axis=1, keepdims=True)
        covered[row, column] = True
    return TargetSurface(low, pitch, z, normal_xy)


def target_map(mesh: Mesh, clamp: tuple[float, float]) -> HeightMap:
    """Upper target surface over the clamp (m x m) on a grid of 1 mm with a node at the origin; 0 beside the part."""
    half = [int(np.floor(side / 2 / MAP_PITCH + 1e-9)) for side in clamp]
    x, y = (MAP_PITCH * np.arange(-n, n + 1, dtype=np.float64) for n in half)
    z = np.zeros((len(y), len(x)))
    corners = mesh.corners()
    for facet, row, column, weight in _samples(corners[:, :, :2], np.array([x[0], y[0]]), MAP_PITCH, z.shape):
        z[row, column] = np.einsum("kc,kc->k", weight, corners[facet, :, 2])
    return HeightMap(x, y, z)


def _refuse_layers(place: Array) -> None:
    raise IsfError(
        ErrorCode.MESH_NOT_HEIGHT_FIELD,
        "two layers of the surface lie over each other",
        where=f"mesh at {place_text(place)}",
        advice="export only the upper face of the formed sheet",
    )


def _samples(
    corners: Array, origin: Array, pitch: float, shape: tuple[int, ...]
) -> Iterator[tuple[Indices, Indices, Indices, Array]]:
    """Grid nodes under every facet: facet, row, column (K,) and barycentric weights (K, 3), in chunks.

    Scan line by scan line: the rows a facet spans, then the columns between its edges in that row.
    """
    grid = (corners - origin) / pitch
    area = _cross(grid[:, 1] - grid[:, 0], grid[:, 2] - grid[:, 0])
    facet = np.flatnonzero(area > 1e-9)
    first_row = np.clip(np.ceil(grid[facet, :, 1].min(axis=1) - 1e-9), 0, None).astype(np.int64)
    last_row = np.clip(np.floor(grid[facet, :, 1].max(axis=1) + 1e-9), None, shape[0] - 1).astype(np.int64)
    pick, row = _ranges(first_row, last_row)
    facet = facet[pick]
    left, right = _span(grid[facet], row.astype(np.float64))
    first = np.clip(np.ceil(left - 1e-9), 0, None).astype(np.int64)
    last = np.clip(np.floor(right + 1e-9), None, shape[1] - 1).astype(np.int64)
    cells = np.cumsum(np.maximum(last - first + 1, 0))
    total = int(cells[-1]) if len(cells) else 0
    cuts = np.searchsorted(cells, np.arange(0, total + _CHUNK, _CHUNK), side="right")
    for begin, end in pairwise(cuts):
        pick, column = _ranges(first[begin:end], last[begin:end])
        index, line = facet[begin:end][pick], row[begin:end][pick]
        point = np.column_stack([column, line]).astype(np.float64)
        a, b, c = grid[index, 0], grid[index, 1], grid[index, 2]
        weight_b = _cross(point - a, c - a) / area[index]
        weight_c = _cross(b - a, point - a) / area[index]
        weight = np.column_stack([1.0 - weight_b - weight_c, weight_b, weight_c])
        yield index, line, column, weight


def _span(triangles: Array, row: Array) -> tuple[Array, Array]:
    """Left and right end (K,) of the cut of triangles (K, 3, 2) by the lines v = row (K,)."""
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        rise = b[:, 1] - a[:, 1]
        level = np.abs(rise) < 1e-12
        share = (row - a[:, 1]) / np.where(level, 1.0, rise)
        crosses = ~level & (share >= -1e-9) & (share <= 1 + 1e-9)
        u = a[:, 0] + np.clip(share, 0.0, 1.0) * (b[:, 0] - a[:, 0])
        left = np.where(crosses, np.minimum(left, u), left)
        right = np.where(crosses, np.maximum(right, u), right)
    return np.where(np.isfinite(left), left, 1.0), np.where(np.isfinite(right), right, 0.0)


def _ranges(first: Indices, last: Indices) -> tuple[Indices, Indices]:
    """For each k the integers first[k] .. last[k]: k repeated, and the integers."""
    length = np.maximum(last - first + 1, 0)
    pick = np.repeat(np.arange(len(first)), length)
    start = np.repeat(np.cumsum(length) - length, length)
    return pick, np.arange(len(pick)) - start + first[pick]


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
