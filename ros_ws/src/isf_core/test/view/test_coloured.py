"""Surfaces that are coloured where something was formed."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from isf_core.view.coloured import beside_formed


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.95))
def test_no_gap_between_the_plain_and_the_coloured_surface(seed: int, share: float) -> None:
    """A cell is drawn where all its four nodes are: every cell belongs to one of the surfaces."""
    colour = np.where(np.random.default_rng(seed).random((9, 11)) < share, 1.0, np.nan)
    plain, coloured = beside_formed(colour), np.isfinite(colour)
    whole = [mask[1:, 1:] & mask[1:, :-1] & mask[:-1, 1:] & mask[:-1, :-1] for mask in (plain, coloured)]
    assert (whole[0] | whole[1]).all()
