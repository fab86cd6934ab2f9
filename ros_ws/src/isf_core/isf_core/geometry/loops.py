"""Plane closed loops of straight sides: how far inside of them a place lies, and how far it is to their sides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from isf_core.types import Array

_AT_A_TIME = 2**20
"""Pairs of place and side that are looked at together: some 50 MB."""


def inside_loops(loops: Sequence[Array], x: Array, y: Array) -> Array:
    """m, distance of the places ``x``, ``y`` m (any equal shapes) from the nearest side of ``loops`` (N, 2) m; negative
    outside of all."""
    begin, along = _sides(loops)
    squared = np.einsum("mi,mi->m", along, along)
    places = np.column_stack([np.ravel(x), np.ravel(y)])
    found = np.empty(len(places))
    step = max(1, _AT_A_TIME // len(begin))
    for first in range(0, len(places), step):
        offset = places[first : first + step, None] - begin
        share = np.clip(np.einsum("nmi,mi->nm", offset, along) / squared, 0.0, 1.0)
        distance = np.linalg.norm(offset - share[..., None] * along, axis=2).min(axis=1)
        above = (offset[..., 1] >= 0.0) & (offset[..., 1] < along[:, 1])
        below = (offset[..., 1] < 0.0) & (offset[..., 1] >= along[:, 1])
        right = (along[:, 0] * offset[..., 1] - along[:, 1] * offset[..., 0]) * np.sign(along[:, 1]) > 0.0
        crossings = ((above | below) & right).sum(axis=1)  # of the ray along +x with the sides of all loops
        found[first : first + step] = np.where(crossings % 2 == 1, distance, -distance)
    return found.reshape(np.shape(x))


def reach_to_loops(loops: Sequence[Array], points: Array, directions: Array) -> Array:
    """(N,) m, how far it is from ``points`` (N, 2) m along ``directions`` (N, 2), of length 1, to the first side of
    ``loops`` (M, 2) m; infinite where there is none."""
    begin, along = _sides(loops)
    offset = begin - points[:, None]
    cross = directions[:, :1] * along[:, 1] - directions[:, 1:] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (offset[..., 0] * along[:, 1] - offset[..., 1] * along[:, 0]) / cross
        share = (offset[..., 0] * directions[:, 1:] - offset[..., 1] * directions[:, :1]) / cross
    met = (reach > 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.asarray(np.where(met, reach, np.inf).min(axis=1))


def crosses_itself(loop: Array) -> bool:
    """True when two sides of ``loop`` (N, 2) m cross between their ends."""
    begin, along = _sides([loop])
    offset = begin - begin[:, None]
    cross = along[:, None, 0] * along[:, 1] - along[:, None, 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (offset[..., 0] * along[:, 1] - offset[..., 1] * along[:, 0]) / cross
        other = (offset[..., 0] * along[:, None, 1] - offset[..., 1] * along[:, None, 0]) / cross
    return bool(((one > 0.0) & (one < 1.0) & (other > 0.0) & (other < 1.0)).any())


def area_of(loop: Array) -> float:
    """m^2, enclosed by ``loop`` (N, 2) m; positive counter-clockwise."""
    x, y = loop.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _sides(loops: Sequence[Array]) -> tuple[Array, Array]:
    """(M, 2), (M, 2) m, where the sides of all loops begin, and what they are long."""
    begin = np.vstack(loops)
    along = np.vstack([np.roll(loop, -1, axis=0) - loop for loop in loops])
    real = np.einsum("mi,mi->m", along, along) > 0.0
    return begin[real], along[real]
