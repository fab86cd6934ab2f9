"""The error that an answer of a node stands for."""

from __future__ import annotations

from isf_core.errors import ErrorCode, failure


def test_a_code_of_this_software_is_that_error() -> None:
    error = failure(1402, "tool 1 lags")
    assert (int(error.code), error.what) == (1402, "tool 1 lags")


def test_a_code_that_nobody_knows_is_told_with_its_number() -> None:
    """As a driver of somebody else's may answer."""
    error = failure(4711, "no idea")
    assert error.code is ErrorCode.TRANSITION_FAILED
    assert "4711" in error.what
    assert "no idea" in error.what
