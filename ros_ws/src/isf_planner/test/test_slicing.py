"""Levels, and the loop at a level: closed, counter-clockwise, with the rule for what lies exactly on it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_planner.slicing import levels, loop_at, signed_area

X = np.linspace(-0.03, 0.03, 61)
GX, GY = np.meshgrid(X, X)
DISTANCE = np.hypot(GX, GY)
BOWL = np.minimum(0.0, DISTANCE - 0.02)  # a cone of 45 deg, opening 20 mm, depth 20 mm


@given(st.floats(0.2e-3, 60e-3), st.floats(0.05e-3, 4e-3))
def test_levels_go_down_in_equal_steps_to_the_full_depth(depth: float, step: float) -> None:
    z = levels(depth, step)
    assert z[-1] == -depth
    steps = -np.diff(np.append(0.0, z))
    np.testing.assert_allclose(steps[:-1], step, rtol=1e-6, atol=1e-12)
    # the last one takes a rest of up to 5 % in addition, and a rest of at least 5 % alone
    if len(z) > 1:
        assert 0.05 * step * (1 - 1e-6) - 1e-12 <= steps[-1] <= 1.05 * step * (1 + 1e-6)


def test_loop_of_a_cone_is_a_closed_circle() -> None:
    loop = loop_at(X, X, BOWL, -5e-3)
    assert signed_area(loop) == pytest.approx(np.pi * 0.015**2, rel=2e-3)  # chords of 1 mm grid
    np.testing.assert_allclose(np.hypot(*loop.T), 0.015, atol=20e-6)


def test_a_floor_exactly_on_the_level_is_inside() -> None:
    """Rule of the module: the loop at floor level runs around the floor."""
    floor = np.maximum(BOWL, -8e-3)
    loop = loop_at(X, X, floor, -8e-3)
    assert np.hypot(*loop.T).min() > 0.011
    assert np.hypot(*loop.T).max() < 0.013


def test_a_terrace_exactly_on_the_level_is_inside() -> None:
    terrace = np.where((DISTANCE > 0.008) & (BOWL < -6e-3), -6e-3, BOWL)
    loop = loop_at(X, X, terrace, -6e-3)
    assert np.hypot(*loop.T).min() > 0.013  # outer border of the terrace (14 mm), not the inner one (8 mm)


def test_no_loop_is_an_error_with_the_level() -> None:
    with pytest.raises(IsfError) as caught:
        loop_at(X, X, np.maximum(BOWL, -5e-3), -6e-3)
    assert caught.value.code is ErrorCode.CONTOUR_LOST
    assert "-6.000 mm" in caught.value.where


def test_a_loop_that_leaves_the_grid_is_an_error() -> None:
    with pytest.raises(IsfError) as caught:
        loop_at(X, X, GX - 0.01, 0.0)
    assert caught.value.code is ErrorCode.CONTOUR_LOST


@pytest.mark.parametrize("kind", ["two pockets", "island"])
def test_several_loops_are_refused_with_a_place(kind: str) -> None:
    if kind == "two pockets":
        height = np.minimum(np.hypot(GX - 0.012, GY), np.hypot(GX + 0.012, GY)) - 0.008
    else:
        height = np.abs(DISTANCE - 0.015) - 0.005
    with pytest.raises(IsfError) as caught:
        loop_at(X, X, height, -2e-3)
    assert caught.value.code is ErrorCode.PROCESS_NOT_SUPPORTED
    assert "2 separate loops" in caught.value.what
