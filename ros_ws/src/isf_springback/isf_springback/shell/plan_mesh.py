"""Triangles over a convex sheet in plan view, of a size that is asked for at every place.

Points start on the leaves of a quadtree, are relaxed as springs (after Persson and Strang 2004) between the edge and
the fixed points, and are joined by a Delaunay triangulation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError, cKDTree

Index = NDArray[np.int64]
SizeField = Callable[[Array], Array]

_ROUNDS = 8
_LEAF = 1.15
_STIFF = 0.2
_KEEP_OFF = 0.6
"""Part of the local size around fixed points in which no other point starts."""


def rectangle(size: tuple[float, float]) -> Array:
    """(4, 2) m, corners of a rectangle with sides ``size`` m about 0, counter-clockwise."""
    return 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * np.asarray(size)


def inward_sides(outline: Array) -> tuple[Array, Array]:
    """(P, 2) unit normals into the convex ``outline`` (P, 2) m, and (P,) m their reach: ``point @ normal - reach`` is
    the distance from a side."""
    along = np.roll(outline, -1, axis=0) - outline
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    return normal, np.einsum("pi,pi->p", normal, outline)


def place_along(loop: Array, size: SizeField, *, start: int = 0) -> Array:
    """(K, 2) m, points on the closed ``loop`` (N, 2) m, spaced by ``size`` and beginning at its point ``start``."""
    loop = np.roll(loop, -start, axis=0)
    fine = _refined(np.vstack([loop, loop[:1]]), 0.25 * float(size(loop).min()))
    density = 1.0 / size(fine)
    step = np.linalg.norm(np.diff(fine, axis=0), axis=1)
    count_before = np.concatenate([[0.0], np.cumsum(0.5 * step * (density[1:] + density[:-1]))])
    count = max(6, round(float(count_before[-1])))
    wanted = np.arange(count) * count_before[-1] / count
    return np.column_stack([np.interp(wanted, count_before, fine[:, axis]) for axis in range(2)])


def _refined(line: Array, spacing: float) -> Array:
    """``line`` (N, 2) with points at most ``spacing`` apart, its own points kept."""
    length = np.linalg.norm(np.diff(line, axis=0), axis=1)
    parts = np.maximum(1, np.ceil(length / spacing).astype(int))
    pieces = [line[i] + (line[i + 1] - line[i]) * (np.arange(n) / n)[:, None] for i, n in enumerate(parts)]
    return np.vstack([*pieces, line[-1:]])


def mesh_in_plan(outline: Array, fixed: Array, size: SizeField) -> tuple[Array, Index, Index]:
    """Points (N, 2) m, triangles (T, 3) counter-clockwise, edge nodes (K,) in order.

    outline : (P, 2) m, corners of the convex sheet, counter-clockwise; fixed : (M, 2) m, become the first M points

    Raises
    ------
    IsfError : SHEET_MESH_FAILED
    """
    edge = np.vstack([_side(outline[i], outline[(i + 1) % len(outline)], size) for i in range(len(outline))])
    normal, reach = inward_sides(outline)
    kept = np.vstack([fixed, edge])
    inner = _leaves(outline, size)
    local = size(inner)
    room = (inner @ normal.T - reach).min(axis=1)
    distance, _ = cKDTree(kept).query(inner)
    inner = inner[(room > 0.4 * local) & (distance > _KEEP_OFF * local)]
    try:
        points = _relaxed(np.vstack([kept, inner]), len(kept), size, normal, reach)
        triangles = Delaunay(points).simplices.astype(np.int64)
    except (QhullError, ValueError) as error:
        raise IsfError(
            ErrorCode.SHEET_MESH_FAILED,
            "the sheet cannot be meshed",
            where="shell mesh",
            advice="check that the contours are finite and lie inside the clamp",
        ) from error
    corners = points[triangles]
    side, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (side[:, 0] * other[:, 1] - side[:, 1] * other[:, 0])
    longest = np.maximum(np.linalg.norm(side, axis=1), np.linalg.norm(other, axis=1))
    solid = np.abs(area) > 1e-6 * longest**2
    triangles, area = triangles[solid], area[solid]
    triangles[area < 0] = triangles[area < 0][:, [0, 2, 1]]
    used = np.zeros(len(points), dtype=bool)
    used[triangles] = True
    if not used[: len(kept)].all():
        raise IsfError(
            ErrorCode.SHEET_MESH_FAILED,
            "points of the edge or of the contours coincide",
            where="shell mesh",
            advice="check that the contours do not touch the clamp",
        )
    number = np.cumsum(used) - 1
    return points[used], number[triangles], np.arange(len(fixed), len(kept), dtype=np.int64)


def _side(start: Array, end: Array, size: SizeField) -> Array:
    """Points from ``start`` to before ``end``."""
    fine = start + (end - start) * np.linspace(0.0, 1.0, 201)[:, None]
    density = 1.0 / size(fine)
    step = float(np.linalg.norm(end - start)) / 200.0
    count_before = np.concatenate([[0.0], np.cumsum(0.5 * step * (density[1:] + density[:-1]))])
    count = max(1, round(float(count_before[-1])))
    share = np.interp(np.arange(count) * count_before[-1] / count, count_before, np.linspace(0.0, 1.0, 201))
    return np.asarray(start + (end - start) * share[:, None])


def _leaves(outline: Array, size: SizeField) -> Array:
    """Centres of quadtree cells no larger than the wanted size, slightly shaken so that no four lie on a circle."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    width = float((high - low).max())
    cells, leaves = 0.5 * (low + high)[None], []
    while len(cells):
        fine = width <= _LEAF * size(cells)
        leaves.append(cells[fine])
        width *= 0.5
        corner = 0.5 * width * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        cells = (cells[~fine][:, None] + corner).reshape(-1, 2)
    points = np.vstack(leaves)
    shake = np.random.default_rng(0).uniform(-0.08, 0.08, points.shape)
    return np.asarray(points + shake * size(points)[:, None])


def _relaxed(points: Array, kept: int, size: SizeField, normal: Array, reach: Array) -> Array:
    for round_ in range(_ROUNDS):
        triangles = Delaunay(points).simplices
        pair = np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        key = np.unique(pair[:, 0].astype(np.int64) * len(points) + pair[:, 1])
        first, second = key // len(points), key % len(points)
        way = points[second] - points[first]
        length = np.linalg.norm(way, axis=1)
        rest = 1.1 * size(0.5 * (points[second] + points[first]))
        push = (np.clip(rest - length, -0.3 * rest, rest) / length)[:, None] * way
        move = np.zeros_like(points)
        for axis in range(2):
            move[:, axis] = np.bincount(second, push[:, axis], len(points)) - np.bincount(
                first, push[:, axis], len(points)
            )
        move[:kept] = 0.0
        points = points + _STIFF * move
        outside = np.minimum((points @ normal.T - reach).min(axis=1), np.inf)
        lost = outside < 0.1 * rest.min()
        if round_ in (2, 5):
            lost |= _crowded(points, kept, first, second, rest)
        lost[:kept] = False
        points = points[~lost]
    return points


def _crowded(points: Array, kept: int, first: Index, second: Index, rest: Array) -> NDArray[np.bool_]:
    """(N,) the younger one of two neighbours that came much closer than wanted."""
    near = np.linalg.norm(points[second] - points[first], axis=1) < 0.5 * rest
    crowded = np.zeros(len(points), dtype=bool)
    crowded[np.maximum(first, second)[near]] = True
    return crowded
