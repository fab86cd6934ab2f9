"""Lines of the grid: even where asked, growing outside, in the number that vector code takes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_sim.explicit_shell.grid import graded_lines


@given(
    begin=st.floats(-0.11, -0.005),
    end=st.floats(0.005, 0.11),
    cell=st.floats(1.5e-3, 8e-3),
    multiple=st.sampled_from([1, 8]),
)
def test_cells_are_even_inside_and_grow_outside(begin: float, end: float, cell: float, multiple: int) -> None:
    largest = 9e-3
    lines = graded_lines(-0.125, 0.125, (begin, end), cell, largest, multiple)
    sizes = np.diff(lines)
    assert (lines[0], lines[-1]) == (-0.125, 0.125)
    assert sizes.size % multiple == 0
    assert sizes.min() > 0.0
    inside = (lines[:-1] > begin - 1e-9) & (lines[1:] < end + 1e-9)
    assert np.ptp(sizes[inside]) < 1e-9
    assert sizes[inside].max() < 1.5 * cell  # one cell at least, also where the region is shorter than one
    assert sizes.max() < 1.5 * largest
    ratios = sizes[1:] / sizes[:-1]
    assert np.maximum(ratios, 1.0 / ratios).max() < 1.8


@given(half=st.floats(0.02, 0.1), off=st.floats(-0.01, 0.01), cell=st.floats(1e-3, 5e-3))
def test_cells_are_not_smaller_than_asked_for_a_multiple(half: float, off: float, cell: float) -> None:
    """Cost goes with the third power of the size: what a row of eight lacks is added where cells are large."""
    lines = graded_lines(-0.125, 0.125, (off - half, off + half), cell, 12e-3, 8)
    sizes = np.diff(lines)
    inside = (lines[:-1] > off - half - 1e-9) & (lines[1:] < off + half + 1e-9)
    assert sizes[inside].min() > 0.88 * cell  # a whole number of them fits into the region
    assert sizes.min() > 0.7 * cell
    count = np.sum(inside)
    assert sizes.size - count < 2 * 20 + 8  # 20 cells of growing size reach from 1 mm over 105 mm


def test_no_grid_where_the_even_region_is_not_inside() -> None:
    with pytest.raises(ValueError, match="no grid"):
        graded_lines(-0.1, 0.1, (-0.2, 0.0), 3e-3, 9e-3)
