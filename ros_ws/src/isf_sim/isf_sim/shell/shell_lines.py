"""Lines of the coarse shell: close together where the sheet is formed, wider towards the clamp.

The lines stand at equal steps of the integral of dx / s(x), where the spacing s is constant over the forming region and
grows linearly with the distance from it. Their number is fixed, so a region that grows moves the lines and leaves the
structure of the matrix as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Array
from scipy.optimize import brentq


@dataclass(frozen=True)
class Grading:
    """finest : m, smallest cell in the forming region ; growth : ratio of neighbouring cells outside it, at most ;
    widest : m, largest cell, as far as the number of lines allows it."""

    finest: float
    growth: float
    widest: float


def graded_lines(length: float, cells: int, low: float, high: float, grading: Grading) -> Array:
    """(cells + 1,) m, lines from -length/2 to length/2 for a forming region from ``low`` to ``high`` m.

    The region is cut to the sheet. Its cells are as small as the number of lines, ``grading.growth`` and
    ``grading.widest`` allow, but not smaller than ``grading.finest``: lines left over make the cells outside smaller.
    """
    half = 0.5 * length
    low, high = max(low, -half), min(high, half)
    sides = (low + half, half - high)
    inside = max(high - low, 0.0)
    slope = float(np.log(grading.growth))

    def count(spacing: float, widest: float) -> float:
        return inside / spacing + sum(_cells_outside(side, spacing, slope, widest) for side in sides)

    spacing, widest = grading.finest, max(grading.widest, 1.001 * length / cells)
    if count(spacing, spacing) <= cells:
        return np.linspace(-half, half, cells + 1)
    if count(spacing, widest) > cells:  # too few lines: larger cells in the region
        spacing = float(brentq(lambda value: count(value, widest) - cells, spacing, widest, xtol=1e-15))
    else:
        widest = float(brentq(lambda value: count(spacing, value) - cells, spacing, widest, xtol=1e-15))
    first, last = _cells_outside(sides[0], spacing, slope, widest), _cells_outside(sides[1], spacing, slope, widest)
    step = np.arange(cells + 1, dtype=np.float64)
    lines = np.where(
        step < first,
        low - _way_outside(first - step, spacing, slope, widest),
        np.where(
            step > cells - last,
            high + _way_outside(step - cells + last, spacing, slope, widest),
            low + (step - first) * spacing,
        ),
    )
    lines[0], lines[-1] = -half, half
    return lines


def _cells_outside(way: float, spacing: float, slope: float, widest: float) -> float:
    """Cells over ``way`` m whose size grows from ``spacing`` by ``slope`` to ``widest``."""
    growing = min(way, (widest - spacing) / slope)
    return float(np.log1p(slope * growing / spacing)) / slope + (way - growing) / widest


def _way_outside(cells: Array, spacing: float, slope: float, widest: float) -> Array:
    """(n,) m, the inverse."""
    growing = float(np.log(widest / spacing)) / slope
    way = spacing / slope * np.expm1(slope * np.clip(cells, 0.0, growing))
    return np.asarray(way + widest * np.maximum(cells - growing, 0.0))


def node_widths(lines: Array) -> Array:
    """(n,) m, half of the cells on either side of every line."""
    cells = np.diff(lines)
    return 0.5 * (np.concatenate([[0.0], cells]) + np.concatenate([cells, [0.0]]))


def linear_weights(lines: Array, places: Array) -> Array:
    """(m, n) values at ``places`` (m,) m of piecewise linear functions of unit values on ``lines`` (n,) m; clamped."""
    first = np.clip(np.searchsorted(lines, places, side="right") - 1, 0, len(lines) - 2)
    share = np.clip((places - lines[first]) / (lines[first + 1] - lines[first]), 0.0, 1.0)
    weights = np.zeros((len(places), len(lines)))
    rows = np.arange(len(places))
    weights[rows, first] = 1.0 - share
    weights[rows, first + 1] += share
    return weights
