"""The surface on which the tip of a ball tool may move: the target dilated by the tool.

A ball of radius R whose tip is at (x, y, h) touches the target z(p) from above when
h(x, y) = max over p of z(p) + sqrt(R^2 - |p - (x, y)|^2) - R. This holds at fillets, edges and floors alike, so a
contour taken from h never cuts into the target. The largest p is the contact; the normal there points from the
contact to the centre of the ball.
"""

from __future__ import annotations

import numpy as np
from isf_core.types import Array, Indices

from isf_planner.surface import surface_kernels
from isf_planner.surface.target_surface import TargetSurface

STRIDE = 5
"""Coarse search: every fifth node of the fine grid."""

REACH_TOLERANCE = 20e-6
"""m, by which the tool may miss the deepest point."""

_WORST = 6

CONSISTENT = 0.02
"""Part of the tool radius: a contact whose smooth normal misses the ball's centre by more lies on an edge."""


def tip_grid(surface: TargetSurface, radius: float) -> tuple[Array, Array, Array]:
    """x (nx,), y (ny,) and tip height h (ny, nx), m, on every fifth node of the fine grid."""
    z = np.ascontiguousarray(surface.z[::STRIDE, ::STRIDE])
    height = surface_kernels.dilate(z, *ball_nodes(radius, surface.pitch * STRIDE))
    return surface.x[::STRIDE], surface.y[::STRIDE], height


def lowest_tip(surface: TargetSurface, tip_height: Array, radius: float) -> float:
    """m, lowest height the tip can reach anywhere; ``tip_height`` as from :func:`tip_grid`.

    The lowest node of the grid is refined twice: a tip resting between two walls rises with their slope beside the
    best place, so that this has to be found to a small part of the pitch.
    """
    row, column = np.unravel_index(int(np.argmin(tip_height)), tip_height.shape)
    place = np.array([surface.x[::STRIDE][column], surface.y[::STRIDE][row]])
    lowest = float(tip_height[row, column])
    for step in (1.0, 0.1):
        square = np.arange(-STRIDE, STRIDE + 1) * 2 * step * surface.pitch
        points = place + np.stack(np.meshgrid(square, square), axis=-1).reshape(-1, 2)
        height, _ = drop_tool(surface, points, radius)
        best = int(np.argmin(height))
        place, lowest = points[best], min(lowest, float(height[best]))
    return lowest


def reached_depth(surface: TargetSurface, tip_height: Array, depth: float, radius: float) -> float:
    """m, how deep the tool gets into a part ``depth`` m deep: all of it where no more than the tolerance is missing.

    ``tip_height`` as from :func:`tip_grid`, ``radius`` m.
    """
    reached = -lowest_tip(surface, tip_height, radius)
    return depth if depth - reached <= REACH_TOLERANCE else reached


def unreached(surface: TargetSurface, tip_height: Array, radius: float, tolerance: float) -> tuple[float, Array]:
    """Most material (m) that the ball leaves above the target because it does not fit there, and the place (3,) m.

    Morphological closing of the target by the ball: a coarse one from ``tip_height`` (as from :func:`tip_grid`)
    finds the worst places and, missing the best tip by up to half a coarse cell, errs to the high side; those
    above ``tolerance`` (m) are then repeated with exact drops on a grid of R / 25.
    """
    z = np.ascontiguousarray(surface.z[::STRIDE, ::STRIDE])
    formed = -surface_kernels.dilate(-tip_height, *ball_nodes(radius, surface.pitch * STRIDE))
    coarse = np.where(np.isfinite(formed), formed - z, 0.0)
    worst = np.argsort(coarse, axis=None)[::-1][:_WORST]
    rows, columns = np.unravel_index(worst, coarse.shape)
    points = np.column_stack([surface.x[::STRIDE][columns], surface.y[::STRIDE][rows], z[rows, columns]])
    first = coarse[rows, columns]
    left = np.array(
        [_left_at(surface, p, radius) if value > tolerance else value for p, value in zip(points, first, strict=True)]
    )
    most = int(np.argmax(left))
    return float(left[most]), points[most]


def _left_at(surface: TargetSurface, point: Array, radius: float) -> float:
    """m between the target at ``point`` (3,) m and the lowest ball over it."""
    offsets = surface.pitch * 2 * _disc(int(radius / surface.pitch / 2), 1).astype(np.float64)
    height, _ = drop_tool(surface, point[:2] + offsets, radius)
    ball = radius - np.sqrt(np.maximum(radius**2 - (offsets**2).sum(axis=1), 0.0))
    return float((height + ball).min() - point[2])


def drop_tool(surface: TargetSurface, points: Array, radius: float, near: Array | None = None) -> tuple[Array, Array]:
    """Tip heights (N,) m and contacts (N, 2) m of balls at ``points`` (N, 2) m.

    ``near`` (N, 2): contacts of balls close by; saves the search over the whole ball.
    """
    if near is None:
        reach = int(radius / surface.pitch) // STRIDE * STRIDE
        _, start = _best(surface, points, _nearest(surface, points), reach, STRIDE, radius)
    else:
        start = _nearest(surface, near)
    height, node = _best(surface, points, start, STRIDE, 1, radius)
    return height, np.asarray(surface.origin + surface.pitch * node[:, ::-1])


def contact_normals(surface: TargetSurface, points: Array, contact: Array, radius: float) -> Array:
    """(N, 3) unit normals from the contact to the centre of balls at ``points`` (N, 2) m.

    The contact found on facets jumps from facet to facet. It is moved to where the normal of the smooth
    surface passes through the ball's centre: q + R n(q) = c, solved by damped iteration (factor 1/2 converges
    for every concave radius above R and every convex radius above R/3). Where no such point is near, the ball
    rolls over an edge and the contact stays.
    """
    q = contact.copy()
    reach = 0.2 * radius
    for _ in range(20):
        q += 0.5 * (points - radius * _normal_xy(surface, q) - q)
        step = q - contact
        length = np.linalg.norm(step, axis=1, keepdims=True)
        q = contact + step * np.minimum(1.0, reach / np.maximum(length, 1e-12))
    miss = np.linalg.norm(points - radius * _normal_xy(surface, q) - q, axis=1)
    q = np.where((miss < CONSISTENT * radius)[:, None], q, contact)
    horizontal = (points - q) / radius
    vertical = np.sqrt(np.maximum(1.0 - (horizontal**2).sum(axis=1), 0.0))
    return np.column_stack([horizontal, vertical])


def ball_nodes(radius: float, pitch: float) -> tuple[Indices, Array]:
    """Node offsets (M, 2) row, column within the radius and how far the ball's surface lies above its tip there."""
    offsets = _disc(int(radius / pitch), 1)
    distance = (offsets**2).sum(axis=1) * pitch**2
    return offsets, radius - np.sqrt(np.maximum(radius**2 - distance, 0.0))


def _disc(reach: int, stride: int) -> Indices:
    steps = np.arange(-reach, reach + 1, stride)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray(grid[(grid**2).sum(axis=1) <= reach**2])


def _nearest(surface: TargetSurface, points: Array) -> Indices:
    """(N, 2) row and column of the nearest node."""
    node = np.rint((points - surface.origin) / surface.pitch).astype(np.int64)[:, ::-1]
    return np.clip(node, 0, np.array(surface.z.shape) - 1)


def _best(
    surface: TargetSurface, points: Array, start: Indices, reach: int, stride: int, radius: float
) -> tuple[Array, Indices]:
    """Highest tip over every ``stride``-th node within ``reach`` of start (N, 2): height (N,) and node (N, 2)."""
    return surface_kernels.best_drop(surface.z, surface.origin, surface.pitch, points, start, reach, stride, radius)


def _normal_xy(surface: TargetSurface, points: Array) -> Array:
    """(N, 2) bilinear horizontal part of the normals at ``points`` (N, 2) m."""
    return surface_kernels.horizontal_normals(surface.normal_xy, surface.origin, surface.pitch, points)
