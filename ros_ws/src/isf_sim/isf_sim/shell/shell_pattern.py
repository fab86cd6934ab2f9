"""Numbering of the coarse shell: active degrees of freedom and the sparsity pattern of its matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.shell.shell_assembly import Pattern

Bool = NDArray[np.bool_]
Index = NDArray[np.int32]


@dataclass(frozen=True)
class Numbering:
    """Active dofs of N nodes and the compressed columns of the matrix over them.

    Attributes
    ----------
    dof : (N, 3) number of u, v, w of each node; ``count`` where the dof is held
    count : active dofs ; pattern : Pattern for the kernels
    rows, starts : row indices and column starts (CSC) ; diagonal : (count,) places of the diagonal
    """

    dof: Index
    count: int
    pattern: Pattern
    rows: Index
    starts: Index
    diagonal: Index


def number_dofs(active: Bool, nx: int, ny: int) -> Index:
    """(N, 3) dof numbers for an (N, 3) mask, along the shorter side of the grid first: the narrowest band."""
    count = int(active.sum())
    dof = np.empty(active.shape, dtype=np.int32)
    nodes = np.arange(nx * ny)
    if nx > ny:
        nodes = nodes.reshape(ny, nx).T.ravel()
    numbers = np.full(active.shape, count, dtype=np.int32)
    numbers[active[nodes]] = np.arange(count, dtype=np.int32)
    dof[nodes] = numbers
    return dof


def make_numbering(nx: int, ny: int, dof: Index) -> Numbering:
    """Pattern of a grid of nx x ny nodes (row by row along x)."""
    count = int(dof.max())
    cells = _cells(nx, ny)
    cell_dof = np.concatenate([dof[cells, k] for k in range(3)], axis=1)
    star = _stars(nx, ny)
    star_dof = dof[star, 2]
    pairs = [_pairs(cell_dof), _pairs(star_dof), (np.arange(count), np.arange(count))]
    row = np.concatenate([p[0] for p in pairs]).astype(np.int64)
    column = np.concatenate([p[1] for p in pairs]).astype(np.int64)
    held = (row == count) | (column == count)
    key = np.where(held, count * count, column * count + row)
    unique, place = np.unique(key, return_inverse=True)
    if held.any():  # the largest key stands for all held dofs: one slot past the end
        unique = unique[:-1]
    slot: Index = place.reshape(-1).astype(np.int32)
    a, b = cell_dof.size * 12, star_dof.size * 5
    pattern = Pattern(
        cells=cells,
        cell_dof=cell_dof,
        cell_slot=slot[:a].reshape(-1, 12, 12),
        star=star,
        star_dof=star_dof,
        star_slot=slot[a : a + b].reshape(-1, 5, 5),
    )
    starts = np.searchsorted(unique // count, np.arange(count + 1)).astype(np.int32)
    return Numbering(dof, count, pattern, (unique % count).astype(np.int32), starts, slot[a + b :])


def _cells(nx: int, ny: int) -> Index:
    i, j = np.meshgrid(np.arange(nx - 1), np.arange(ny - 1))
    first = (j * nx + i).ravel()
    return np.stack([first, first + 1, first + nx, first + nx + 1], axis=1).astype(np.int32)


def _pairs(dof: Index) -> tuple[Index, Index]:
    width = dof.shape[1]
    return np.repeat(dof, width, axis=1).ravel(), np.tile(dof, (1, width)).ravel()


def _stars(nx: int, ny: int) -> Index:
    """(N, 5) node, left, right, down, up; the node itself in the place of one beyond the edge."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(nx), np.arange(ny)))
    node = j * nx + i
    star = np.stack([node, node, node, node, node], axis=1)
    for first, index, length, stride in ((1, i, nx, 1), (3, j, ny, nx)):
        star[index > 0, first] -= stride
        star[index < length - 1, first + 1] += stride
    return star.astype(np.int32)


def star_weights(x: Array, y: Array) -> tuple[Array, Array]:
    """(N, 5), (N, 5) 1/m^2, second differences along x and y on lines m; across the edge the sheet is mirrored
    (zero slope in the clamp)."""
    xx, yy = np.zeros((len(y), len(x), 5)), np.zeros((len(y), len(x), 5))
    xx[:, :, :3] = _three_points(x)
    yy[:, :, [0, 3, 4]] = _three_points(y)[:, None]
    return xx.reshape(-1, 5), yy.reshape(-1, 5)


def _three_points(lines: Array) -> Array:
    """(n, 3) 1/m^2, second difference at every line: weights of the line itself, the one before, the one after."""
    cell = np.diff(lines)
    before = np.concatenate([cell[:1], cell])
    after = np.concatenate([cell, cell[-1:]])
    weights = 2.0 / np.stack([-before * after, before * (before + after), after * (before + after)], axis=1)
    weights[0, 1:] = 0.0, -weights[0, 0]
    weights[-1, 1:] = -weights[-1, 0], 0.0
    return np.asarray(weights)
