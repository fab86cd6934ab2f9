"""The scanned sheet as a surface of triangles, thinned for viewers."""

from __future__ import annotations

import numpy as np
from isf_core.types import Array, Indices

SCALE = np.array([[0.99, 0.91, 0.14], [0.37, 0.79, 0.38], [0.13, 0.57, 0.55], [0.23, 0.32, 0.55], [0.27, 0.0, 0.33]])
"""(5, 3) red, green, blue from the flat sheet to the deepest place: viridis, turned round."""

LEAST_DEPTH = 1e-3
"""m; a sheet that is flatter than this has one colour."""


def surface(points: Array, most: int) -> tuple[Array, Indices]:
    """Vertices (V, 3) m and triangles (T, 3) of ``points`` (P, 3) m with at most ``most`` vertices along a side.

    The points of each square of a grid become their mean. Where a square is empty, as where a tool hid the sheet, there
    is a hole. Points that are not finite are left out; fewer than four give no triangles.
    """
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 4:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    count = max(2, min(most, int(np.sqrt(len(points)))))
    extent = np.maximum(high - low, 1e-9)
    columns, rows = (
        np.minimum((count * (points[:, k] - low[k]) / extent[k]).astype(np.int64), count - 1) for k in (0, 1)
    )
    square = rows * count + columns
    filled = np.bincount(square, minlength=count * count)
    sums = np.stack([np.bincount(square, points[:, k], count * count) for k in range(3)], axis=1)
    number = np.where(filled > 0, np.cumsum(filled > 0) - 1, -1).reshape(count, count)
    vertices = sums[filled > 0] / filled[filled > 0, None]
    corners = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    corners = corners[(corners >= 0).all(axis=1)]
    return vertices, np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


def height_colours(heights: Array) -> Array:
    """(V, 3) red, green, blue of heights (V,) m, by depth below the flat sheet or height over it."""
    depth = np.abs(heights)
    share = depth / max(float(depth.max(initial=0.0)), LEAST_DEPTH)
    steps = np.linspace(0.0, 1.0, len(SCALE))
    return np.stack([np.interp(share, steps, SCALE[:, k]) for k in range(3)], axis=1)
