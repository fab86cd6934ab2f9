"""The flat base of a part moves with the tool: the region inside the last loop of the tip track follows it.

Inside the track the base B satisfies lap B = -q with B = tip height on the track (the pillow q is small); the sheet
is lowered to it: Z <- min(Z, B).
"""

from __future__ import annotations

import math

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.sheet.surface import Surface, TipTrack

LOOPS = 1.15
"""Loops of track that count as the present boundary."""
ENCLOSED, OUTSIDE, TRACK = 0, 1, 2
RELAXATION = 1.85
LARGEST_SWEEPS = 150
ACCURACY = 1.0e-7
"""m, change per sweep at which the base is settled."""


def follow(surface: Surface, track: TipTrack, path: float, loop: float, pillow: float, radius: float) -> None:
    """Lower the enclosed base; ``path`` m in contact so far, ``loop`` m, ``pillow`` m of a large base, ``radius`` m."""
    if loop > 0.0:
        _follow(surface, track, path - LOOPS * loop, pillow, track.h**2, (4.0 * radius) ** 2)


@kernel
def _follow(surface: Surface, track: TipTrack, first: float, pillow: float, cell: float, large: float) -> None:
    """``first`` m of path that counts; ``cell`` m^2 of the track; ``large`` m^2 over pi, base with the whole pillow."""
    j0, j1, i0, i1 = _box(track.visited, first)
    if j1 <= j0:
        return
    stack = np.empty((j1 - j0) * (i1 - i0), dtype=np.int64)
    cells = _find_enclosed(track, first, j0, j1, i0, i1, stack)
    if cells <= 4:
        return
    square = cells * cell / math.pi
    height = pillow * min(1.0, square / large)
    _relax(track, 4.0 * height / square * cell, j0, j1, i0, i1)
    _lower(surface, track, j0, j1, i0, i1)


@kernel
def _box(visited: Array, first: float) -> tuple[int, int, int, int]:
    """Rows and columns, first and one past the last, round what was visited since ``first`` m and one node more."""
    ny, nx = visited.shape
    j0, j1, i0, i1 = ny, 0, nx, 0
    for j in range(ny):
        for i in range(nx):
            if visited[j, i] >= first:
                j0, j1 = min(j0, j - 1), max(j1, j + 2)
                i0, i1 = min(i0, i - 1), max(i1, i + 2)
    return max(j0, 0), min(j1, ny), max(i0, 0), min(i1, nx)


@kernel
def _find_enclosed(track: TipTrack, first: float, j0: int, j1: int, i0: int, i1: int, stack: NDArray[np.int64]) -> int:
    """Flood the box from its border; what neither the flood nor the track covers is enclosed. Returns its cells."""
    region, width = track.region, i1 - i0
    region[:] = OUTSIDE
    n = 0
    for j in range(j0, j1):
        for i in range(i0, i1):
            region[j, i] = TRACK if track.visited[j, i] >= first else ENCLOSED
    for j in range(j0, j1):
        for i in range(i0, i1):
            if (j in (j0, j1 - 1) or i in (i0, i1 - 1)) and region[j, i] == ENCLOSED:
                region[j, i] = OUTSIDE
                stack[n] = (j - j0) * width + i - i0
                n += 1
    while n > 0:
        n -= 1
        j, i = j0 + stack[n] // width, i0 + stack[n] % width
        for dj, di in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            jj, ii = j + dj, i + di
            if j0 <= jj < j1 and i0 <= ii < i1 and region[jj, ii] == ENCLOSED:
                region[jj, ii] = OUTSIDE
                stack[n] = (jj - j0) * width + ii - i0
                n += 1
    count = 0
    for j in range(j0, j1):
        for i in range(i0, i1):
            if region[j, i] == ENCLOSED:
                count += 1
    return count


@kernel
def _relax(track: TipTrack, source: float, j0: int, j1: int, i0: int, i1: int) -> None:
    """Successive over-relaxation of lap B = -q from the last base; ``source`` = q h^2, m.

    A node waits for the one before it in its row and the one above it, for none of its own diagonal: taken diagonal by
    diagonal the processor works on several at once, and every node still meets the same values as row by row.
    """
    base, region = track.base, track.region
    width = base.shape[1]
    flat, below, beside = base.reshape(-1), np.uint64(width), np.uint64(1)
    inside, n = np.empty((j1 - j0) * (i1 - i0), dtype=np.uint64), 0
    for j in range(j0, j1):
        for i in range(i0, i1):
            if region[j, i] == TRACK:
                base[j, i] = track.tip[j, i]
    for diagonal in range(j0 + i0 + 2, j1 + i1 - 3):
        for j in range(max(j0 + 1, diagonal - i1 + 2), min(j1 - 1, diagonal - i0)):
            if region[j, diagonal - j] == ENCLOSED:
                inside[n] = j * width + diagonal - j
                n += 1
    for _ in range(LARGEST_SWEEPS):
        largest = 0.0
        for node in inside[:n]:
            mean = 0.25 * (flat[node - below] + flat[node + below] + flat[node - beside] + flat[node + beside] + source)
            change = RELAXATION * (mean - flat[node])
            flat[node] += change
            if abs(change) > largest:
                largest = abs(change)
        if largest < ACCURACY:
            break


@kernel
def _lower(surface: Surface, track: TipTrack, j0: int, j1: int, i0: int, i1: int) -> None:
    """Z <- min(Z, B) where the four track nodes round a fine node are base or track; B is bilinear between these."""
    ny, nx = surface.height.shape
    h, region, base = track.h, track.region, track.base
    first_row = max(int((track.y0 + j0 * h - surface.y0) / surface.h), 0)
    last_row = min(int((track.y0 + j1 * h - surface.y0) / surface.h) + 1, ny)
    first_column = max(int((track.x0 + i0 * h - surface.x0) / surface.h), 0)
    last_column = min(int((track.x0 + i1 * h - surface.x0) / surface.h) + 1, nx)
    before, share = np.empty(nx, dtype=np.int64), np.empty(nx)
    for column in range(first_column, last_column):
        place = (surface.x0 + column * surface.h - track.x0) / h
        before[column] = int(place)
        share[column] = max(place, 0.0) - before[column]
    for row in range(first_row, last_row):
        place = (surface.y0 + row * surface.h - track.y0) / h
        r = int(place)
        if r < j0 or r >= j1 - 1:
            continue
        b = max(place, 0.0) - r
        for column in range(first_column, last_column):
            c = before[column]
            if c < i0 or c >= i1 - 1:
                continue
            if (
                region[r, c] != OUTSIDE
                and region[r, c + 1] != OUTSIDE
                and region[r + 1, c] != OUTSIDE
                and region[r + 1, c + 1] != OUTSIDE
            ):
                a = share[column]
                value = (1.0 - b) * ((1.0 - a) * base[r, c] + a * base[r, c + 1]) + b * (
                    (1.0 - a) * base[r + 1, c] + a * base[r + 1, c + 1]
                )
                surface.height[row, column] = min(surface.height[row, column], value)
