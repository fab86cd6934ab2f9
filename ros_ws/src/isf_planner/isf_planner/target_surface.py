"""The target surface on regular grids: facets rasterised to heights and smooth normals.

Two uses: a fine grid over the formed region, on which the tool is dropped (:mod:`isf_planner.tip_surface`), and
the 1 mm height map over the whole clamp that is published and compared with scans. Where there is no facet the
sheet is flat: z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.height_map import HeightMap
from numpy.typing import NDArray

from isf_planner import surface_kernels
from isf_planner.mesh_checks import place_text
from isf_planner.mesh_input import Mesh
from isf_planner.surface_normals import CREASE

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


@dataclass(frozen=True)
class TargetSurface:
    """Heights and normals on a regular grid in frame ``sheet``.

    Attributes
    ----------
    origin : (2,) m, x and y of node (0, 0)
    pitch : m
    z : (ny, nx) m
    normal_xy : (ny, nx, 2) horizontal part of the unit upward normal of the smooth surface
    facet_width : m, how wide facets of the formed region are across (median of their shortest sides)
    """

    origin: Array
    pitch: float
    z: Array
    normal_xy: Array
    facet_width: float = 0.0

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
    formed = mesh.faces[(mesh.vertices[:, 2] < -1e-6)[mesh.faces].any(axis=1)]
    used = np.zeros(len(mesh.vertices), dtype=np.bool_)
    used[formed] = True
    region = mesh.vertices[used, :2]
    low, high = region.min(axis=0) - 1.5 * radius, region.max(axis=0) + 1.5 * radius
    pitch = max(radius / CELLS_PER_RADIUS, float((high - low).max()) / LARGEST_GRID)
    shape = tuple(int(n) for n in np.ceil((high - low) / pitch)[::-1] + 1)
    z = np.zeros(shape)
    normal_xy = np.zeros((*shape, 2))
    covered = np.zeros(shape, dtype=np.bool_)
    vertex, facet = surface_kernels.vertex_normals(mesh.vertices, mesh.faces)
    crease = float(np.cos(CREASE))
    row, column = surface_kernels.rasterise(
        mesh.vertices, mesh.faces, vertex, facet, crease, low, pitch, OVERLAP_TOLERANCE, z, normal_xy, covered
    )
    if row >= 0:
        _refuse_layers(np.array([low[0] + pitch * column, low[1] + pitch * row, z[row, column]]))
    return TargetSurface(low, pitch, z, normal_xy, _facet_width(mesh.vertices[formed]))


def _facet_width(corners: Array) -> float:
    """m, median over facets with ``corners`` (F, 3, 3) m of the shortest side."""
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return float(np.median(sides.min(axis=1)))


def target_map(mesh: Mesh, clamp: tuple[float, float]) -> HeightMap:
    """Upper target surface over the clamp (m x m) on a grid of 1 mm with a node at the origin; 0 beside the part."""
    half = [int(np.floor(side / 2 / MAP_PITCH + 1e-9)) for side in clamp]
    x, y = (MAP_PITCH * np.arange(-n, n + 1, dtype=np.float64) for n in half)
    z = np.zeros((len(y), len(x)))
    none = np.empty((0, 3))
    surface_kernels.rasterise(
        mesh.vertices,
        mesh.faces,
        none,
        none,
        0.0,
        np.array([x[0], y[0]]),
        MAP_PITCH,
        np.inf,
        z,
        np.empty((0, 0, 2)),
        np.zeros(z.shape, dtype=np.bool_),
    )
    return HeightMap(x, y, z)


def _refuse_layers(place: Array) -> None:
    raise IsfError(
        ErrorCode.MESH_NOT_HEIGHT_FIELD,
        "two layers of the surface lie over each other",
        where=f"mesh at {place_text(place)}",
        advice="export only the upper face of the formed sheet",
    )
