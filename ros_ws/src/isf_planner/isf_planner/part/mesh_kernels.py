"""Compiled loops over whole meshes: merging vertices, measuring facets."""

from __future__ import annotations

import numpy as np
from isf_core.types import Array, Indices

from isf_planner.jit import kernel


@kernel
def merge(vertices: Array, faces: Indices, distance: float) -> tuple[Array, Indices]:
    """One vertex for all that round to the same multiples of ``distance`` m; facets left without an area are dropped.

    Vertices without a facet are left out; the others keep the order of their first use.
    """
    size = 16
    while size < len(vertices) + len(vertices) // 4:
        size *= 2
    slots = np.full(size, -1, dtype=np.int32)
    points = np.empty((len(vertices), 3))
    grid = np.empty((len(vertices), 3), dtype=np.int64)
    number = np.full(len(vertices), -1, dtype=np.int64)
    kept = np.empty_like(faces)
    used, facets = 0, 0
    corner = np.empty(3, dtype=np.int64)
    before = np.zeros((3, 3))  # corners of the facet before, which often shares two with this one
    before_number = np.full(3, -1, dtype=np.int64)
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        if nx * nx + ny * ny + nz * nz <= distance**4:
            continue
        for k in range(3):
            v = faces[f, k]
            for other in range(3):
                if (
                    before_number[other] >= 0
                    and vertices[v, 0] == before[other, 0]
                    and vertices[v, 1] == before[other, 1]
                    and vertices[v, 2] == before[other, 2]
                ):
                    number[v] = before_number[other]
            if number[v] < 0:
                x = int(np.rint(vertices[v, 0] / distance))
                y = int(np.rint(vertices[v, 1] / distance))
                z = int(np.rint(vertices[v, 2] / distance))
                slot = ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (size - 1)
                while slots[slot] >= 0:
                    p = slots[slot]
                    if grid[p, 0] == x and grid[p, 1] == y and grid[p, 2] == z:
                        break
                    slot = (slot + 1) & (size - 1)
                if slots[slot] < 0:
                    slots[slot] = used
                    grid[used, 0], grid[used, 1], grid[used, 2] = x, y, z
                    points[used] = vertices[v]
                    used += 1
                number[v] = slots[slot]
            corner[k] = number[v]
        for k in range(3):
            before_number[k] = corner[k]
            for d in range(3):
                before[k, d] = vertices[faces[f, k], d]
        if corner[0] != corner[1] and corner[1] != corner[2] and corner[2] != corner[0]:
            kept[facets] = corner
            facets += 1
    return points[:used].copy(), kept[:facets].copy()


@kernel
def facing(vertices: Array, faces: Indices) -> tuple[int, float, float, int]:
    """Facets that look down: how many, their area and that of all seen from above (m^2), and the worst facet."""
    count, down, total = 0, 0.0, 0.0
    worst, lowest = 0, 0.0
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        total += 0.5 * abs(nz)
        if nz < -1e-6 * np.sqrt(nx * nx + ny * ny + nz * nz):
            count += 1
            down -= 0.5 * nz
        if nz < lowest:
            worst, lowest = f, nz
    return count, down, total, worst


@kernel
def steepest(vertices: Array, faces: Indices, smallest: float) -> tuple[float, int]:
    """Largest wall angle (rad) of facets of more than ``smallest`` m^2, and the facet."""
    least, worst = 1.0, 0
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        size = np.sqrt(nx * nx + ny * ny + nz * nz)
        if 0.5 * size >= smallest and nz / size < least:
            least, worst = nz / size, f
    return np.arccos(min(max(least, -1.0), 1.0)), worst
