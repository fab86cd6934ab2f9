"""Levels, and the loop at a level: closed, counter-clockwise, with the rule for what lies exactly on it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_planner.loops.tip_loops import levels, loops_at, signed_area


def loop_at(x: np.ndarray, y: np.ndarray, height: np.ndarray, level: float) -> np.ndarray:
    """The only loop at a level, which is a pocket."""
    ((loop, island),) = loops_at(x, y, height, level)
    assert not island
    return loop


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


def test_below_the_deepest_place_there_is_no_loop() -> None:
    assert loops_at(X, X, np.maximum(BOWL, -5e-3), -6e-3) == []


def test_a_loop_that_leaves_the_grid_is_an_error() -> None:
    with pytest.raises(IsfError) as caught:
        loops_at(X, X, GX - 0.01, 0.0)
    assert caught.value.code is ErrorCode.CONTOUR_LOST


def test_two_pockets_are_two_loops() -> None:
    height = np.minimum(np.hypot(GX - 0.012, GY), np.hypot(GX + 0.012, GY)) - 0.008
    found = loops_at(X, X, height, -2e-3)
    assert [island for _, island in found] == [False, False]
    np.testing.assert_allclose([signed_area(loop) for loop, _ in found], np.pi * 0.006**2, rtol=0.02)


def test_an_island_runs_clockwise_inside_its_pocket() -> None:
    height = np.abs(DISTANCE - 0.015) - 0.005
    found = loops_at(X, X, height, -2e-3)
    area = {island: signed_area(loop) for loop, island in found}
    assert area[False] == pytest.approx(np.pi * 0.018**2, rel=0.01)
    assert area[True] == pytest.approx(-np.pi * 0.012**2, rel=0.01)


def test_a_pocket_in_an_island_is_a_pocket() -> None:
    height = np.abs(DISTANCE - 0.015) - 0.005
    height = np.where(DISTANCE < 0.008, np.minimum(height, DISTANCE - 0.006), height)
    found = loops_at(X, X, height, -2e-3)
    assert sorted((island, round(np.sqrt(abs(signed_area(loop)) / np.pi), 3)) for loop, island in found) == [
        (False, 0.004),
        (False, 0.018),
        (True, 0.012),
    ]
