"""Fine-grid state of the sheet: the plastic surface that conforms to the tool, and its memory.

The surface is the upper face of the unloaded sheet in frame ``sheet``. "Path length" is the way the forming tip
has travelled since the blank was clamped; it tells passes of the tool over the same material apart.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel

LONG_AGO = -1.0e9
"""m, path length of an event that has not happened."""


class Surface(NamedTuple):
    """Fine grid, node (j, i) at (x0 + i h, y0 + j h); all lengths m, forces N.

    Attributes
    ----------
    height : (ny, nx) plastic surface ; before : (ny, nx) the same before the present pass of the tool
    touched : (ny, nx) path length at which the present pass first touched a node
    formed : (ny, nx) 1 where the tool that presses has formed, -1 where the other one has
    squeeze, squeeze_before, squeezed : (ny, nx) largest squeeze force, the same before the present pass, path length
    origin : (ny, nx, 2) m, where a node's material lay on the flat blank minus where it is (x, y)
    bending : (ny, nx) 1/m, curvatures 1/R of the tools that a node's material was bent to, a pass each, summed up
    support : (ny, nx) upper face of a sheet that lies on the rigid surface below, at rest; -inf where there is none
    holder : (2,) 1 where a support stands at all, its rise m
    """

    x0: float
    y0: float
    h: float
    height: Array
    before: Array
    touched: Array
    formed: NDArray[np.int8]
    squeeze: Array
    squeeze_before: Array
    squeezed: Array
    origin: Array
    bending: Array
    support: Array
    holder: Array


class TipTrack(NamedTuple):
    """Coarser grid with the track of the forming tip and the base that follows it.

    Attributes
    ----------
    tip : (ny, nx) m, tip height at the last visit ; visited : (ny, nx) m, way in contact at that visit
    base : (ny, nx) m, surface spanned over the region inside the track
    region : (ny, nx) 0 enclosed, 1 outside, 2 track (from the last update)
    """

    x0: float
    y0: float
    h: float
    tip: Array
    visited: Array
    base: Array
    region: NDArray[np.int8]


def flat_surface(size: tuple[float, float], h: float) -> Surface:
    """A fresh blank of ``size`` m on a grid of spacing ``h`` m that covers it."""
    nx, ny = _nodes(size, h)
    shape = (ny, nx)
    return Surface(
        x0=-0.5 * h * (nx - 1),
        y0=-0.5 * h * (ny - 1),
        h=h,
        height=np.zeros(shape),
        before=np.zeros(shape),
        touched=np.full(shape, LONG_AGO),
        formed=np.zeros(shape, dtype=np.int8),
        squeeze=np.zeros(shape),
        squeeze_before=np.zeros(shape),
        squeezed=np.full(shape, LONG_AGO),
        origin=np.zeros((*shape, 2)),
        bending=np.zeros(shape),
        support=np.full(shape, -np.inf),
        holder=np.zeros(2),
    )


def empty_track(size: tuple[float, float], h: float) -> TipTrack:
    """No track yet, on a grid of spacing ``h`` m."""
    nx, ny = _nodes(size, h)
    shape = (ny, nx)
    return TipTrack(
        x0=-0.5 * h * (nx - 1),
        y0=-0.5 * h * (ny - 1),
        h=h,
        tip=np.zeros(shape),
        visited=np.full(shape, LONG_AGO),
        base=np.zeros(shape),
        region=np.ones(shape, dtype=np.int8),
    )


def sample(surface: Surface, x: Array, y: Array) -> tuple[Array, Array]:
    """The sheet at the crossings of the lines x, y m.

    (len(y), len(x)) m, its height averaged over half of the lines' spacing; (len(y), len(x), 2) m, ``origin`` at the
    nearest nodes.
    """
    rows = _windows(y.tobytes(), surface.y0, surface.h)
    columns = _windows(x.tobytes(), surface.x0, surface.h)
    height, origin = np.empty((len(y), len(x))), np.empty((len(y), len(x), 2))
    _sample(surface.height, surface.origin, rows, columns, height, origin)
    return height, origin


@lru_cache(maxsize=16)
def _windows(lines: bytes, start: float, h: float) -> NDArray[np.int64]:
    """(n, 2) middle and half width, in nodes of the fine grid, of the windows round the lines (n,) m, as bytes."""
    places = np.frombuffer(lines)
    middle, half = np.rint((places - start) / h), np.rint(0.25 * np.gradient(places) / h)
    return np.stack([middle, half], axis=1).astype(np.int64)


@kernel
def _sample(
    values: Array, places: Array, rows: NDArray[np.int64], columns: NDArray[np.int64], mean: Array, place: Array
) -> None:
    ny, nx = values.shape
    for r in range(rows.shape[0]):
        middle_j, tall = rows[r]
        j0, j1 = middle_j - tall, middle_j + tall + 1
        for c in range(columns.shape[0]):
            middle_i, wide = columns[c]
            i0, i1 = middle_i - wide, middle_i + wide + 1
            total = 0.0
            if j0 >= 0 and i0 >= 0 and j1 <= ny and i1 <= nx:
                for j in range(j0, j1):
                    for i in range(i0, i1):
                        total += values[j, i]
            else:
                for j in range(j0, j1):
                    for i in range(i0, i1):
                        total += values[min(max(j, 0), ny - 1), min(max(i, 0), nx - 1)]
            mean[r, c] = total / ((2 * tall + 1) * (2 * wide + 1))
            j, i = min(max(middle_j, 0), ny - 1), min(max(middle_i, 0), nx - 1)
            place[r, c, 0], place[r, c, 1] = places[j, i, 0], places[j, i, 1]


@kernel
def bilinear_grid(values: Array, rows: Array, columns: Array, out: Array) -> None:
    """``values`` at fractional rows (m,) and columns (n,), written to ``out`` (m, n); clamped at the border."""
    ny, nx = values.shape
    for j in range(rows.shape[0]):
        r = min(max(rows[j], 0.0), ny - 1.0)
        r0 = min(int(r), ny - 2)
        b = r - r0
        for i in range(columns.shape[0]):
            c = min(max(columns[i], 0.0), nx - 1.0)
            c0 = min(int(c), nx - 2)
            a = c - c0
            out[j, i] = (1.0 - b) * ((1.0 - a) * values[r0, c0] + a * values[r0, c0 + 1]) + b * (
                (1.0 - a) * values[r0 + 1, c0] + a * values[r0 + 1, c0 + 1]
            )


@kernel
def bilinear(values: Array, x0: float, y0: float, h: float, x: float, y: float) -> float:
    """``values`` (ny, nx) of a grid with origin (x0, y0) and spacing h at (x, y), all m; clamped at the border."""
    i, j, a, b = corner_of(values, x0, y0, h, x, y)
    return (1.0 - b) * ((1.0 - a) * values[j, i] + a * values[j, i + 1]) + b * (
        (1.0 - a) * values[j + 1, i] + a * values[j + 1, i + 1]
    )


@kernel
def corner_of(values: Array, x0: float, y0: float, h: float, x: float, y: float) -> tuple[int, int, float, float]:
    """Column and row of the node before (x, y) m on the grid of ``values``, and the shares of the way to the next ones;
    clamped at the border."""
    ny, nx = values.shape
    c = min(max((x - x0) / h, 0.0), nx - 1.0)
    r = min(max((y - y0) / h, 0.0), ny - 1.0)
    i, j = min(int(c), nx - 2), min(int(r), ny - 2)
    return i, j, c - i, r - j


def _nodes(size: tuple[float, float], h: float) -> tuple[int, int]:
    """Nodes that cover ``size``; rounding noise in size / h must not add a row."""
    nx, ny = (int(np.ceil(length / h - 1e-6)) + 1 for length in size)
    return nx, ny
