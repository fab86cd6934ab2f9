"""A mesh as heights on a regular grid, and such a grid as a mesh again.

What follows a part over many shapes (preforms, morphed shapes) or looks for its features wants nodes at equal
distances, whatever facets the part came in.
"""

from __future__ import annotations

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_planner.part.meshes import Mesh
from isf_planner.surface import surface_kernels


def sample(mesh: Mesh, pitch: float, flange: float, margin: float = 0.0) -> HeightMap:
    """Heights of ``mesh`` every ``pitch`` m over its bounding box, up to one cell and ``margin`` m larger on each side.

    The middle of the grid is that of the bounding box, so that both are placed alike on a blank. Beside the facets
    it has the height of the ``flange``, m.
    """
    low, high = mesh.vertices[:, :2].min(axis=0) - margin, mesh.vertices[:, :2].max(axis=0) + margin
    cells = np.ceil((high - low) / pitch).astype(int)
    origin = 0.5 * (low + high) - 0.5 * pitch * cells
    z = np.full((cells[1] + 1, cells[0] + 1), flange)
    none, covered = np.empty((0, 3)), np.zeros(z.shape, dtype=np.bool_)
    surface_kernels.rasterise(
        mesh.vertices, mesh.faces, none, none, 0.0, origin, pitch, np.inf, z, np.empty((0, 0, 2)), covered
    )
    x, y = (origin[axis] + pitch * np.arange(z.shape[1 - axis]) for axis in range(2))
    return HeightMap(np.asarray(x), np.asarray(y), z)


def pitch_of(heights: HeightMap) -> float:
    """m, distance of neighbouring nodes."""
    return float((heights.x[-1] - heights.x[0]) / (len(heights.x) - 1))


def as_mesh(heights: HeightMap) -> Mesh:
    """Two facets per cell, cut from the corner of lowest to that of highest x and y; normals up."""
    node = np.arange(heights.z.size).reshape(heights.z.shape)
    a, b, c, d = (corner.ravel() for corner in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    return Mesh(heights.points(), np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))


def nearest_node(heights: HeightMap, points: Array) -> tuple[Array, Array]:
    """Row (N,) and column (N,) of the node nearest to each of ``points`` (N, 2) m; border nodes beyond the grid."""
    pitch = pitch_of(heights)
    column = np.clip(np.rint((points[:, 0] - heights.x[0]) / pitch), 0, len(heights.x) - 1).astype(np.int64)
    row = np.clip(np.rint((points[:, 1] - heights.y[0]) / pitch), 0, len(heights.y) - 1).astype(np.int64)
    return row, column
