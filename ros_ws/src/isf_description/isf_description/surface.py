"""The scanned sheet as a surface of triangles, thinned for viewers."""

from __future__ import annotations

import numpy as np
from isf_core.types import Array, Indices, Mask

SCALE = np.array([[0.99, 0.91, 0.14], [0.37, 0.79, 0.38], [0.13, 0.57, 0.55], [0.23, 0.32, 0.55], [0.27, 0.0, 0.33]])
"""(5, 3) red, green, blue from the flat sheet to the deepest place: viridis, turned round."""

LEAST_DEPTH = 1e-3
"""m; a sheet that is flatter than this has one colour."""


FORMED = 0.2e-3
"""m; from the height of most of the sheet, beyond which a point is formed."""

FAR = 10.0
"""Half widths of the sheet from its middle, beyond which a point is none of it."""

RIM = 4
"""Vertices on each side between the formed place and the edge of the sheet, where all is flat."""


def surface(points: Array, most: int) -> tuple[Array, Indices]:
    """Vertices (V, 3) m and triangles (T, 3) of ``points`` (P, 3) m, about ``most`` vertices across the formed place.

    The points of each cell of a grid, fine where the sheet is formed, become their mean. A cell that is empty, as where
    a tool hid the sheet, is a hole. Points that are not finite, or far from all others as what a scanner writes where
    it sees nothing, are left out; fewer than four give no triangles.
    """
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) >= 4:
        away = np.abs(points - np.median(points, axis=0))
        width = float(np.quantile(away[:, :2].max(axis=1), 0.95))
        points = points[away.max(axis=1) <= FAR * width]
    if len(points) < 4:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    place, shape = [], []
    formed = np.abs(points[:, 2] - np.median(points[:, 2])) > FORMED
    extent = np.maximum(np.ptp(points[:, :2], axis=0), 1e-9)
    pitch = 1.01 * float(np.sqrt(extent[0] * extent[1] / len(points)))  # cells that are finer would be empty
    for k in (0, 1):
        edges = _edges(points[:, k], formed, most, pitch)
        place.append(np.searchsorted(edges, points[:, k], side="right"))
        shape.append(len(edges) + 1)
    columns, rows = shape
    cell = place[1] * columns + place[0]
    filled = np.bincount(cell, minlength=rows * columns)
    sums = np.stack([np.bincount(cell, points[:, k], rows * columns) for k in range(3)], axis=1)
    number = np.where(filled > 0, np.cumsum(filled > 0) - 1, -1).reshape(rows, columns)
    vertices = sums[filled > 0] / filled[filled > 0, None]
    corners = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    corners = corners[(corners >= 0).all(axis=1)]
    return vertices, np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


def _edges(values: Array, formed: Mask, most: int, pitch: float) -> Array:
    """m, inner edges of the cells along one axis."""
    low, high = float(values.min()), float(values.max())
    if not formed.any():
        first, last = low, high
    else:
        first, last = float(values[formed].min()), float(values[formed].max())
        margin = 0.05 * (last - first) + 2.0 * pitch
        first, last = max(low, first - margin), min(high, last + margin)
    pieces = []
    for begin, end, wanted in ((low, first, RIM), (first, last, most), (last, high, RIM)):
        count = min(wanted, int((end - begin) / pitch))
        if count > 0:
            pieces.append(np.linspace(begin, end, count + 1))
    inner = np.unique(np.concatenate(pieces))[1:-1] if pieces else np.empty(0)
    strip = 0.9 * pitch  # the outermost row alone, so that the surface ends where the sheet does
    return np.array([low + strip, *inner[(inner > low + strip) & (inner < high - strip)], high - strip])


def height_colours(heights: Array) -> Array:
    """(V, 3) red, green, blue of heights (V,) m, by depth below the flat sheet or height over it."""
    depth = np.abs(heights)
    share = depth / max(float(depth.max(initial=0.0)), LEAST_DEPTH)
    steps = np.linspace(0.0, 1.0, len(SCALE))
    return np.stack([np.interp(share, steps, SCALE[:, k]) for k in range(3)], axis=1)
