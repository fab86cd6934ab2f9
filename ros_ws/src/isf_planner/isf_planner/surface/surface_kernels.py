"""Compiled inner loops of the sampled surface: rasterising facets, dropping balls, smooth normals at the corners.

What they compute, and why, is told where they are used: :mod:`isf_planner.surface.target_surface`,
:mod:`isf_planner.surface.tip_surface` and :mod:`isf_planner.surface.target_surface`.
"""

from __future__ import annotations

import numpy as np
from isf_core.types import Array, Indices
from numpy.typing import NDArray

from isf_planner.jit import kernel

EDGE = 1e-9
"""Part of a cell by which a node beside an edge still counts as under the facet."""


@kernel
def vertex_normals(vertices: Array, faces: Indices) -> tuple[Array, Array]:
    """Vertex normals (V, 3) averaged by area times corner angle, and facet normals (F, 3); unit, zero without area."""
    vertex = np.zeros_like(vertices)
    facet = np.zeros((len(faces), 3))
    side = np.empty((3, 3))
    length = np.empty(3)
    for f in range(len(faces)):
        for c in range(3):
            for d in range(3):
                side[c, d] = vertices[faces[f, (c + 1) % 3], d] - vertices[faces[f, c], d]
            length[c] = np.sqrt(side[c, 0] ** 2 + side[c, 1] ** 2 + side[c, 2] ** 2)
        nx = side[0, 1] * side[1, 2] - side[0, 2] * side[1, 1]
        ny = side[0, 2] * side[1, 0] - side[0, 0] * side[1, 2]
        nz = side[0, 0] * side[1, 1] - side[0, 1] * side[1, 0]
        double_area = np.sqrt(nx * nx + ny * ny + nz * nz)
        if double_area == 0.0:
            continue
        facet[f, 0], facet[f, 1], facet[f, 2] = nx / double_area, ny / double_area, nz / double_area
        for c in range(3):
            before = (c + 2) % 3
            along = -(side[c, 0] * side[before, 0] + side[c, 1] * side[before, 1] + side[c, 2] * side[before, 2])
            weight = np.arctan2(double_area, along) * double_area
            for d in range(3):
                vertex[faces[f, c], d] += weight * facet[f, d]
    for v in range(len(vertex)):
        size = np.sqrt(vertex[v, 0] ** 2 + vertex[v, 1] ** 2 + vertex[v, 2] ** 2)
        if size > 0.0:
            for d in range(3):
                vertex[v, d] /= size
    return vertex, facet


@kernel
def rasterise(
    vertices: Array,
    faces: Indices,
    vertex_normal: Array,
    facet_normal: Array,
    crease: float,
    origin: Array,
    pitch: float,
    tolerance: float,
    z: Array,
    normal_xy: Array,
    covered: NDArray[np.bool_],
) -> Indices:
    """Write heights and normals of every node under a facet; (row, column) of two layers, or (-1, -1).

    Corners whose vertex normal has a cosine below ``crease`` to the facet's use the facet's; facets that face down
    or are vertical cover nothing; ``normal_xy`` may be empty (0, 0, 2) when only heights are wanted.
    """
    ny, nx = z.shape
    with_normals = normal_xy.shape[0] > 0
    twice = np.full(2, -1, dtype=np.int64)
    u, v, h = np.empty(3), np.empty(3), np.empty(3)
    n = np.empty((3, 3))
    for f in range(len(faces)):
        for c in range(3):
            p = faces[f, c]
            u[c] = (vertices[p, 0] - origin[0]) / pitch
            v[c] = (vertices[p, 1] - origin[1]) / pitch
            h[c] = vertices[p, 2]
        area = (u[1] - u[0]) * (v[2] - v[0]) - (v[1] - v[0]) * (u[2] - u[0])
        if area <= 1e-9:
            continue
        first_row = max(int(np.ceil(min(v[0], v[1], v[2]) - EDGE)), 0)
        last_row = min(int(np.floor(max(v[0], v[1], v[2]) + EDGE)), ny - 1)
        if first_row > last_row or max(u[0], u[1], u[2]) < -EDGE or min(u[0], u[1], u[2]) > nx - 1 + EDGE:
            continue
        if with_normals:
            for c in range(3):
                p = faces[f, c]
                along = (
                    vertex_normal[p, 0] * facet_normal[f, 0]
                    + vertex_normal[p, 1] * facet_normal[f, 1]
                    + vertex_normal[p, 2] * facet_normal[f, 2]
                )
                for d in range(3):
                    n[c, d] = facet_normal[f, d] if along < crease else vertex_normal[p, d]
        for row in range(first_row, last_row + 1):
            left, right = np.inf, -np.inf
            for c in range(3):
                e = (c + 1) % 3
                rise = v[e] - v[c]
                if abs(rise) < 1e-12:
                    continue
                share = (row - v[c]) / rise
                if share < -EDGE or share > 1.0 + EDGE:
                    continue
                at = u[c] + min(max(share, 0.0), 1.0) * (u[e] - u[c])
                left, right = min(left, at), max(right, at)
            if left > right:
                continue
            for column in range(max(int(np.ceil(left - EDGE)), 0), min(int(np.floor(right + EDGE)), nx - 1) + 1):
                b = ((column - u[0]) * (v[2] - v[0]) - (row - v[0]) * (u[2] - u[0])) / area
                c = ((u[1] - u[0]) * (row - v[0]) - (v[1] - v[0]) * (column - u[0])) / area
                a = 1.0 - b - c
                height = a * h[0] + b * h[1] + c * h[2]
                if covered[row, column] and abs(z[row, column] - height) > tolerance and twice[0] < 0:
                    twice[0], twice[1] = row, column
                z[row, column] = height
                covered[row, column] = True
                if with_normals:
                    sx = a * n[0, 0] + b * n[1, 0] + c * n[2, 0]
                    sy = a * n[0, 1] + b * n[1, 1] + c * n[2, 1]
                    sz = a * n[0, 2] + b * n[1, 2] + c * n[2, 2]
                    size = np.sqrt(sx * sx + sy * sy + sz * sz)
                    normal_xy[row, column, 0] = sx / size
                    normal_xy[row, column, 1] = sy / size
    return twice


@kernel
def dilate(z: Array, offsets: Indices, drops: Array) -> Array:
    """(ny, nx) highest ``z[node + offset] - drop`` over the offsets (M, 2), M drops in m."""
    ny, nx = z.shape
    out = np.full((ny, nx), -np.inf)
    for row in range(ny):
        for m in range(len(offsets)):
            other = row + offsets[m, 0]
            if other < 0 or other >= ny:
                continue
            shift, drop = offsets[m, 1], drops[m]
            for column in range(max(0, -shift), min(nx, nx - shift)):
                value = z[other, column + shift] - drop
                if value > out[row, column]:
                    out[row, column] = value
    return out


@kernel
def hung(z: Array, fall: float) -> Array:
    """(ny, nx) m, lowest surface above ``z`` that nowhere falls faster than ``fall`` m per node: the highest of the
    cones that hang from all nodes.

    Cones are followed outwards ring by ring, the highest first. A node below another cone is passed over: its own cone
    lies below that one everywhere. On a ring that lies below others by a quarter of a fall at every node, a cone ends:
    a cone that is higher at a node of the ring stays so behind it, but for the detour of less than a quarter of a node
    that the way past a node is.
    """
    ny, nx = z.shape
    out = z.copy()
    order = np.argsort(z.ravel())
    for k in range(len(order) - 1, -1, -1):
        row, column = order[k] // nx, order[k] % nx
        top = z[row, column]
        if out[row, column] > top:
            continue
        for ring in range(1, max(nx, ny)):
            ends = True
            for j in range(max(row - ring, 0), min(row + ring + 1, ny)):
                stride = 1 if abs(j - row) == ring else 2 * ring
                for i in range(column - ring, column + ring + 1, stride):
                    if i < 0 or i >= nx:
                        continue
                    value = top - fall * np.sqrt(float(j - row) ** 2 + float(i - column) ** 2)
                    ends = ends and value + 0.25 * fall <= out[j, i]
                    out[j, i] = max(out[j, i], value)
            if ends:
                break
    return out


@kernel
def best_drop(
    z: Array, origin: Array, pitch: float, points: Array, start: Indices, reach: int, stride: int, radius: float
) -> tuple[Array, Indices]:
    """Highest tip of a ball at every point over the nodes around start (N, 2): heights (N,) and nodes (N, 2).

    Nodes within ``reach`` rows and columns of the start are tried, every ``stride``-th.
    """
    ny, nx = z.shape
    height = np.full(len(points), -np.inf)
    node = np.zeros((len(points), 2), dtype=np.int64)
    square = radius * radius
    steps = reach // stride
    for k in range(len(points)):
        row, column = start[k, 0], start[k, 1]
        best, best_row, best_column = -np.inf, row, column
        x, y = points[k, 0] - origin[0], points[k, 1] - origin[1]
        first_row = row - stride * min(steps, row // stride)
        last_row = min(row + stride * steps, ny - 1)
        first = column - stride * min(steps, column // stride)
        last = min(column + stride * steps, nx - 1)
        for j in range(first_row, last_row + 1, stride):
            dy = pitch * j - y
            room = square - dy * dy
            if room < 0.0:
                continue
            for i in range(first, last + 1, stride):
                dx = pitch * i - x
                rest = room - dx * dx
                below = best - z[j, i]
                # most nodes are too low for any root: the product is much cheaper
                if rest >= 0.0 and (below < 0.0 or rest > below * below):
                    value = z[j, i] + np.sqrt(rest)
                    if value > best:
                        best, best_row, best_column = value, j, i
        height[k] = best - radius
        node[k, 0], node[k, 1] = best_row, best_column
    return height, node


@kernel
def ball_cut(z: Array, origin: Array, pitch: float, centres: Array, reach: Array) -> Array:
    """(N,) m, how far the surface nodes come within ``reach`` (N,) m of the ``centres`` (N, 3) below or above it."""
    ny, nx = z.shape
    deepest = np.full(len(centres), -np.inf)
    for k in range(len(centres)):
        x, y, height, limit = centres[k, 0], centres[k, 1], centres[k, 2], reach[k]
        nearest = np.inf
        first_row = max(int(np.ceil((y - limit - origin[1]) / pitch)), 0)
        last_row = min(int(np.floor((y + limit - origin[1]) / pitch)), ny - 1)
        first = max(int(np.ceil((x - limit - origin[0]) / pitch)), 0)
        last = min(int(np.floor((x + limit - origin[0]) / pitch)), nx - 1)
        for row in range(first_row, last_row + 1):
            dy = origin[1] + pitch * row - y
            for column in range(first, last + 1):
                dx = origin[0] + pitch * column - x
                dz = z[row, column] - height
                square = dx * dx + dy * dy + dz * dz
                if square < nearest:
                    nearest = square
        deepest[k] = limit - np.sqrt(nearest)
    return deepest


@kernel
def horizontal_normals(normal_xy: Array, origin: Array, pitch: float, points: Array) -> Array:
    """(N, 2) bilinear horizontal part of the normals at ``points`` (N, 2) m."""
    ny, nx = normal_xy.shape[0], normal_xy.shape[1]
    out = np.empty((len(points), 2))
    for k in range(len(points)):
        u = min(max((points[k, 0] - origin[0]) / pitch, 0.0), nx - 1.001)
        v = min(max((points[k, 1] - origin[1]) / pitch, 0.0), ny - 1.001)
        i, j = int(u), int(v)
        fu, fv = u - i, v - j
        for d in range(2):
            lower = normal_xy[j, i, d] * (1 - fu) + normal_xy[j, i + 1, d] * fu
            upper = normal_xy[j + 1, i, d] * (1 - fu) + normal_xy[j + 1, i + 1, d] * fu
            out[k, d] = lower * (1 - fv) + upper * fv
    return out
