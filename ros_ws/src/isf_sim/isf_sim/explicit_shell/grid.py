"""Lines of a structured grid: even in the forming region, wider towards the clamp."""

from __future__ import annotations

import numpy as np
from isf_core.types import Array

GROWTH = 1.25
"""Largest ratio of neighbouring cells outside the even region."""

SLIVER = 0.7
"""Of a cell: a strip outside the even region that is narrower becomes part of it."""

GROWTHS = 101
"""Ratios that are tried."""


def graded_lines(
    low: float, high: float, even: tuple[float, float], cell: float, largest: float, multiple: int = 1
) -> Array:
    """Lines (n,) m from ``low`` to ``high``; cells of ``cell`` m between the two of ``even``, up to ``largest`` m out.

    ``multiple``: the number of cells is one of it; there are more outside the even region for that, or, where there is
    no outside, smaller ones in it.

    Raises
    ------
    ValueError : ``even`` is not inside, or a cell is not positive
    """
    begin, end = even
    if not (low <= begin < end <= high and 0.0 < cell <= largest):
        raise ValueError(f"no grid from {low} to {high} m with cells of {cell} m from {begin} to {end} m")
    begin = low if begin - low < SLIVER * cell else begin
    end = high if high - end < SLIVER * cell else end
    count = max(1, round((end - begin) / cell))
    lengths = begin - low, high - end
    while True:
        cell = (end - begin) / count
        cells = [len(_steps(length, cell, largest, GROWTH)) for length in lengths]
        for _ in range(-(count + sum(cells)) % multiple):
            side = max((0, 1), key=lambda k: lengths[k] / cells[k] if cells[k] else 0.0)  # of the larger cells
            cells[side] += bool(cells[side])
        below, above = (_with_cells(length, cell, largest, n) for length, n in zip(lengths, cells, strict=True))
        if below is not None and above is not None and (count + sum(cells)) % multiple == 0:
            inside = np.linspace(begin, end, count + 1)
            lines = np.concatenate([begin - np.cumsum(below)[::-1], inside, end + np.cumsum(above)])
            lines[[0, -1]] = low, high
            return lines
        count += 1


def _with_cells(length: float, cell: float, largest: float, count: int) -> list[float] | None:
    """``count`` steps, m, over ``length`` that grow as slowly as that needs; None: cells of ``cell`` m are fewer."""
    for growth in np.linspace(GROWTH, 1.0, GROWTHS):
        steps = _steps(length, cell, largest, float(growth))
        if len(steps) == count:
            return steps
        if len(steps) > count:
            break
    return None


def _steps(length: float, cell: float, largest: float, growth: float) -> list[float]:
    """Steps, m, over ``length``, each longer than the one before by ``growth``, up to ``largest``."""
    if not length > 0.0:
        return []
    steps: list[float] = []
    size = cell
    while sum(steps) < length:
        size = min(size * growth, largest)
        steps.append(size)
    if len(steps) > 1 and sum(steps) - length > 0.5 * steps[-1]:
        steps.pop()
    scale = length / sum(steps)
    return [scale * step for step in steps]
