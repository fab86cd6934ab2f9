"""Joining a morphed shape to the backing plate by cubic Bezier curves (Behera 2015, Multi-step mesh morphing).

The flange is not morphed, so a morphed shape begins at it with an edge. Across that edge runs a curve P(u) of the
points A on the plate, B, C and D on the shape: it leaves A along the plate and reaches D along the shape. The lengths
|AB| and |CD| shape it.
"""

from __future__ import annotations

import numpy as np
from isf_core.types import Array, Mask
from scipy import ndimage

STEPS = 24
"""Points of a curve at which it is tabulated."""


def control_points(start: Array, start_tangent: Array, end: Array, end_tangent: Array, share: float) -> Array:
    """(N, 4, C) points A, B, C, D of curves from ``start`` to ``end`` (N, C) m along unit tangents (N, C).

    Both tangents point from A to D; ``share``: |AB| and |CD| over |AD|.
    """
    length = share * np.linalg.norm(end - start, axis=1, keepdims=True)
    return np.stack([start, start + length * start_tangent, end - length * end_tangent, end], axis=1)


def curve(points: Array, u: Array) -> Array:
    """(N, M, C) P(u) of curves with the control ``points`` (N, 4, C) at ``u`` (M,) from 0 at A to 1 at D."""
    weight = np.stack([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3], axis=1)
    return np.swapaxes(np.tensordot(points, weight, axes=([1], [1])), 1, 2)


def joined(z: Array, flange: Mask, pitch: float, width: float, share: float) -> Array:
    """Heights ``z`` (ny, nx) m with curves from the ``flange`` (ny, nx), at z = 0, to ``width`` m inside it.

    Nodes take the height of the curve that runs through them, straight inwards from the nearest node of the flange.
    Where the shape ends within ``width`` there is nothing to join to, and it stays.
    """
    distance, nearest = ndimage.distance_transform_edt(~flange, return_indices=True)
    distance = distance * pitch
    band = (distance > 0.0) & (distance < width)
    rows, columns = np.nonzero(band)
    if len(rows) == 0:
        return z
    foot = nearest[:, rows, columns].astype(float)
    inward = np.stack([rows, columns]) - foot
    inward /= np.linalg.norm(inward, axis=0)
    reach = width / pitch

    def height(steps: float) -> Array:
        return ndimage.map_coordinates(z, foot + steps * inward, order=1, mode="nearest")

    end = height(reach)
    slope = (height(reach + 0.5) - height(reach - 0.5)) / pitch
    inside = ndimage.map_coordinates(distance, foot + reach * inward, order=1, mode="nearest") > 0.7 * width
    tangent = np.column_stack([np.ones(len(rows)), slope])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    start, level = np.zeros((len(rows), 2)), np.tile([1.0, 0.0], (len(rows), 1))
    line = curve(
        control_points(start, level, np.column_stack([np.full(len(rows), width), end]), tangent, share),
        np.linspace(0.0, 1.0, STEPS),
    )
    along = distance[band]
    after = np.clip((line[:, :, 0] < along[:, None]).sum(axis=1), 1, STEPS - 1)
    pick = np.arange(len(rows))
    x0, x1 = line[pick, after - 1, 0], line[pick, after, 0]
    part = np.clip((along - x0) / np.maximum(x1 - x0, 1e-12), 0.0, 1.0)
    value = line[pick, after - 1, 1] + part * (line[pick, after, 1] - line[pick, after - 1, 1])
    found = z.copy()
    found[rows[inside], columns[inside]] = value[inside]
    return found
