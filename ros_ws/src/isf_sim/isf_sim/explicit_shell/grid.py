"""Lines of a structured grid: even in the forming region, wider towards the clamp."""

from __future__ import annotations

import numpy as np
from isf_core.types import Array

GROWTH = 1.25
"""Ratio of neighbouring cells outside the even region."""


def graded_lines(
    low: float, high: float, even: tuple[float, float], cell: float, largest: float, multiple: int = 1
) -> Array:
    """Lines (n,) m from ``low`` to ``high``; cells of ``cell`` m between the two of ``even``, up to ``largest`` m out.

    ``multiple``: the number of cells is one of it; those of the even region are made smaller for that.

    Raises
    ------
    ValueError : ``even`` is not inside, or a cell is not positive
    """
    begin, end = even
    if not (low <= begin < end <= high and 0.0 < cell <= largest):
        raise ValueError(f"no grid from {low} to {high} m with cells of {cell} m from {begin} to {end} m")
    count = max(1, round((end - begin) / cell))
    while True:
        cell = (end - begin) / count
        outer = [_grown(length, cell, largest) for length in (begin - low, high - end)]
        if (count + outer[0].size + outer[1].size) % multiple == 0:
            return np.concatenate([low + outer[0][::-1], np.linspace(begin, end, count + 1), high - outer[1]])
        count += 1


def _grown(length: float, cell: float, largest: float) -> Array:
    """Distances (n,) m from the far end of ``length`` m, of lines that get wider from the near end on; far end last."""
    if length < 0.25 * cell:
        return np.empty(0) if length == 0.0 else np.zeros(1)
    steps: list[float] = []
    size, total = cell, 0.0
    while total < length:
        size = min(size * GROWTH, largest)
        steps.append(size)
        total += size
    if len(steps) > 1 and sum(steps) - length > 0.5 * steps[-1]:
        steps.pop()
    places = np.cumsum(steps) * (length / sum(steps))
    return np.append(length - places[:-1], 0.0)
