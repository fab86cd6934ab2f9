"""Shares in percent: rounded down, and exact where they are."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_analysis.measures.percent import in_percent, percent


@pytest.mark.parametrize(
    ("fraction", "text"),
    [
        (0.8869565, "88.6 %"),
        (0.29, "29.0 %"),
        (0.57, "57.0 %"),
        (0.89999, "89.9 %"),
        (0.9999, "99.9 %"),
        (1.0, "100 %"),
    ],
)
def test_a_share_that_falls_short_never_reads_as_the_wanted_one(fraction: float, text: str) -> None:
    assert percent(fraction, 1) == text


@given(st.integers(0, 1000))
def test_what_has_no_more_digits_is_shown_as_it_is(tenths: int) -> None:
    assert in_percent(tenths / 1000, 1) == tenths / 10
