"""The fuzzy controller of a cylinder (Torrao 2013, chapter 5): 49 rules, evaluated once into a table of 21 x 21.

Mamdani inference: the smaller membership of error and rate cuts off the set of a rule's output, the union of all cut
sets is taken, and its centre of gravity is the output. The shapes of the sets are not published; they are seven evenly
spaced triangles on [-1, 1].
"""

from __future__ import annotations

import numpy as np
from isf_core.types import Array

from isf_sim.jit import kernel

RULES = (
    ("pb", "pb", "pb", "pm", "pm", "ps", "ze"),
    ("pb", "pb", "pm", "pm", "ps", "ze", "ns"),
    ("pm", "pm", "ps", "ps", "ze", "ns", "nm"),
    ("pm", "ps", "ze", "ze", "ze", "ns", "nm"),
    ("pm", "ps", "ze", "ns", "ns", "nm", "nm"),
    ("ps", "ze", "ns", "nm", "nm", "nb", "nb"),
    ("ze", "ns", "nm", "nm", "nb", "nb", "nb"),
)
"""Torrao 2013, Table 5.1: rows are the error (measured less wanted) from nb to pb, columns its rate."""
SETS = ("nb", "nm", "ns", "ze", "ps", "pm", "pb")
POINTS = 21
"""Of the table, along each axis (Torrao 2013, 5.3)."""
UNIVERSE = 1201
"""Points of the output in which the centre of gravity is taken; every corner of a set is one."""


def membership(value: Array) -> Array:
    """(..., 7) in the sets of ``value`` (...) in [-1, 1]: triangles centred at -1, -2/3 ... 1."""
    centres = np.linspace(-1.0, 1.0, len(SETS))
    return np.clip(1.0 - 3.0 * np.abs(np.asarray(value, dtype=np.float64)[..., None] - centres), 0.0, 1.0)


def infer(error: float, rate: float) -> float:
    """Output in [-1, 1] for ``error`` and ``rate`` in [-1, 1], by inference from the rules."""
    strength = np.minimum.outer(membership(np.array(error)), membership(np.array(rate)))
    strongest = np.zeros(len(SETS))
    for row, names in enumerate(RULES):
        for column, name in enumerate(names):
            at = SETS.index(name)
            strongest[at] = max(strongest[at], strength[row, column])
    output = np.linspace(-1.0, 1.0, UNIVERSE)
    union = np.minimum(membership(output), strongest).max(axis=1)
    return float((union * output).sum() / union.sum())


def build_table() -> Array:
    """(21, 21) outputs over error (rows) and rate (columns) from -1 to 1."""
    axis = np.linspace(-1.0, 1.0, POINTS)
    return np.array([[infer(error, rate) for rate in axis] for error in axis])


@kernel
def look_up(error: float, rate: float, table: Array) -> float:
    """Bilinear in ``table``; inputs beyond -1 to 1 count as the ends."""
    last = table.shape[0] - 1
    at_row = (min(max(error, -1.0), 1.0) + 1.0) * 0.5 * last
    at_column = (min(max(rate, -1.0), 1.0) + 1.0) * 0.5 * last
    row, column = min(int(at_row), last - 1), min(int(at_column), last - 1)
    down, across = at_row - row, at_column - column
    upper = table[row, column] + across * (table[row, column + 1] - table[row, column])
    lower = table[row + 1, column] + across * (table[row + 1, column + 1] - table[row + 1, column])
    return upper + down * (lower - upper)
