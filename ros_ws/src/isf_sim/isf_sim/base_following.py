"""The flat base of a part moves with the tool: the region inside the last loop of the tip track follows it.

Inside the track the base B satisfies lap B = -q with B = tip height on the track (the pillow q is small); the sheet
is lowered to it: Z <- min(Z, B).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.surface import Surface, TipTrack, bilinear

Array = NDArray[np.float64]

LOOPS = 1.15
"""Loops of track that count as the present boundary."""
ENCLOSED, OUTSIDE, TRACK = 0, 1, 2
RELAXATION = 1.85
LARGEST_SWEEPS = 150
ACCURACY = 1.0e-7
"""m, change per sweep at which the base is settled."""


def follow(surface: Surface, track: TipTrack, path: float, loop: float, pillow: float, radius: float) -> None:
    """Lower the enclosed base; ``path`` m travelled, ``loop`` m, ``pillow`` m of a large base, tool ``radius`` m."""
    if loop <= 0.0:
        return
    first = path - LOOPS * loop
    j0, j1, i0, i1 = _box(track.visited, first)
    if j1 <= j0:
        return
    stack = np.empty((j1 - j0) * (i1 - i0), dtype=np.int64)
    cells = _find_enclosed(track, first, j0, j1, i0, i1, stack)
    if cells <= 4:
        return
    square = cells * track.h**2 / math.pi
    height = pillow * min(1.0, square / (4.0 * radius) ** 2)
    _relax(track, 4.0 * height / square * track.h**2, j0, j1, i0, i1)
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
    """Successive over-relaxation of lap B = -q from the last base; ``source`` = q h^2, m."""
    base, region = track.base, track.region
    for j in range(j0, j1):
        for i in range(i0, i1):
            if region[j, i] == TRACK:
                base[j, i] = track.tip[j, i]
    for _ in range(LARGEST_SWEEPS):
        largest = 0.0
        for j in range(j0 + 1, j1 - 1):
            for i in range(i0 + 1, i1 - 1):
                if region[j, i] == ENCLOSED:
                    mean = 0.25 * (base[j - 1, i] + base[j + 1, i] + base[j, i - 1] + base[j, i + 1] + source)
                    change = RELAXATION * (mean - base[j, i])
                    base[j, i] += change
                    largest = max(largest, abs(change))
        if largest < ACCURACY:
            break


@kernel
def _lower(surface: Surface, track: TipTrack, j0: int, j1: int, i0: int, i1: int) -> None:
    """Z <- min(Z, B) where the four track nodes round a fine node are base or track."""
    ny, nx = surface.height.shape
    h, region = track.h, track.region
    first_row = max(int((track.y0 + j0 * h - surface.y0) / surface.h), 0)
    last_row = min(int((track.y0 + j1 * h - surface.y0) / surface.h) + 1, ny)
    first_column = max(int((track.x0 + i0 * h - surface.x0) / surface.h), 0)
    last_column = min(int((track.x0 + i1 * h - surface.x0) / surface.h) + 1, nx)
    for row in range(first_row, last_row):
        y = surface.y0 + row * surface.h
        b = int((y - track.y0) / h)
        for column in range(first_column, last_column):
            x = surface.x0 + column * surface.h
            a = int((x - track.x0) / h)
            if a < i0 or b < j0 or a >= i1 - 1 or b >= j1 - 1:
                continue
            if (
                region[b, a] != OUTSIDE
                and region[b, a + 1] != OUTSIDE
                and region[b + 1, a] != OUTSIDE
                and region[b + 1, a + 1] != OUTSIDE
            ):
                value = bilinear(track.base, track.x0, track.y0, h, x, y)
                surface.height[row, column] = min(surface.height[row, column], value)
