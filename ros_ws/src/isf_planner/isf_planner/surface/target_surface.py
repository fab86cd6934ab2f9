"""The target surface on regular grids: heights, smooth normals and principal curvatures.

Two uses: a fine grid over the formed region, on which the tool is dropped (:mod:`isf_planner.surface.tip_surface`), and
the 1 mm height map over the whole clamp that is published and compared with scans. Where there is no facet the
sheet is flat: z = 0.

Normals are those of the smooth surface that the facets stand for. A facet's own normal is off by up to half the angle
between neighbouring facets (some degrees). Normals at the vertices, averaged with the weight area times corner angle
(which does not depend on how quads were split) and interpolated over the facet, follow the smooth surface to second
order. Sharp edges stay sharp: corners whose average is far from their facet keep the facet's normal.

Curvatures follow from the change of the normals: the slopes p, q of the surface are differenced over a tenth of the
tool radius. With the first and second fundamental form of a height field, I = [[1 + p^2, p q], [p q, 1 + q^2]] and
II = [[z_xx, z_xy], [z_xy, z_yy]] / sqrt(1 + p^2 + q^2), the curvatures are the eigenvalues of I^-1 II. At an edge of
the mesh they are those of a rounding of about a tenth of the tool radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from scipy.ndimage import convolve1d

from isf_planner.part.mesh_checks import place_text
from isf_planner.part.meshes import Mesh
from isf_planner.surface import surface_kernels

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


def on_grid(heights: HeightMap, target: HeightMap) -> HeightMap:
    """``heights`` of the whole part on the grid of ``target``; 0 beside the part."""
    z = heights.at(target.points()[:, :2]).reshape(target.z.shape)
    return HeightMap(target.x, target.y, np.nan_to_num(z))


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


CREASE = np.radians(15.0)
"""rad, a vertex normal that deviates more from a facet lies on an edge (of twice this angle), not on a smooth face."""


FACETS_SMOOTHED = 4.0
"""Facets across which normals along a loop are smoothed."""


def facet_normals(mesh: Mesh) -> Array:
    """(F, 3) unit normals of the facets; zero for a facet without area."""
    return surface_kernels.vertex_normals(mesh.vertices, mesh.faces)[1]


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
    smooth = convolve1d(normals, _parabola_weights(window // 2), axis=0, mode="wrap")
    return np.asarray(smooth / np.linalg.norm(smooth, axis=1, keepdims=True))


def _parabola_weights(half: int) -> Array:
    """(2 half + 1,) weights of the middle value of a parabola fitted to as many points (Savitzky and Golay's).

    scipy.signal has them too, but takes 0.5 s to import, a fifth of the start of `isf plan`.
    """
    i = np.arange(-half, half + 1)
    return np.asarray(
        3.0 * (3 * half**2 + 3 * half - 1 - 5 * i**2) / ((2 * half - 1) * (2 * half + 1) * (2 * half + 3))
    )


REACH = 0.1
"""Part of the tool radius over which normals are compared."""


def principal(surface: TargetSurface, contact: Array, radius: float) -> Array:
    """(N, 2) 1/m, the larger first, positive where the surface is concave seen from above.

    ``contact`` (N, 2) m in x and y; ``radius`` of the tool, m.
    """
    step = REACH * radius
    sides = np.array([[0.0, 0.0], [step, 0.0], [-step, 0.0], [0.0, step], [0.0, -step]])
    points = (contact[:, None, :] + sides).reshape(-1, 2)
    horizontal = surface_kernels.horizontal_normals(surface.normal_xy, surface.origin, surface.pitch, points)
    vertical = np.sqrt(np.maximum(1.0 - (horizontal**2).sum(axis=1), 0.01))
    slope = (-horizontal / vertical[:, None]).reshape(-1, 5, 2)
    along_x = (slope[:, 1] - slope[:, 2]) / (2 * step)
    along_y = (slope[:, 3] - slope[:, 4]) / (2 * step)
    zxx, zyy, zxy = along_x[:, 0], along_y[:, 1], 0.5 * (along_x[:, 1] + along_y[:, 0])
    p, q = slope[:, 0].T
    w = 1.0 + p * p + q * q
    mean = ((1 + q * q) * zxx - 2 * p * q * zxy + (1 + p * p) * zyy) / (2 * w**1.5)
    gauss = (zxx * zyy - zxy * zxy) / (w * w)
    root = np.sqrt(np.maximum(mean * mean - gauss, 0.0))
    return np.column_stack([mean + root, mean - root])
