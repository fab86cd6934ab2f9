"""Equal spacing and aligned starts of closed loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_planner.loops.tip_loops import FEWEST_POINTS, first_start, perimeter, resample, with_equal_chords

ANGLE = 2 * np.pi * np.arange(400) / 400
CIRCLE = 0.02 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
SQUARE = 0.02 * np.array([[1.0, 0.0], [1, 1], [-1, 1], [-1, -1], [1, -1]])


def chords(loop: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.3, 1.0), st.floats(0, 6.28), st.floats(0.2e-3, 2e-3))
def test_spacing_on_smooth_loops(flat: float, start: float, spacing: float) -> None:
    loop = CIRCLE * [1.0, flat]
    points = resample(loop, spacing, 0.03 * np.array([np.cos(start), np.sin(start)]))
    assert len(points) == max(FEWEST_POINTS, round(perimeter(loop) / spacing))
    # equal arcs; their chords are shorter by (spacing / radius)^2 / 24, radius of an ellipse b^2 / a
    radius = 0.02 * flat**2
    arc = perimeter(loop) / len(points)
    assert chords(points) == pytest.approx(arc, rel=(arc / radius) ** 2 / 12 + 1e-3)


def test_equal_chords_around_sharp_corners() -> None:
    assert np.ptp(chords(resample(SQUARE, 0.7e-3, SQUARE[0]))) > 0.05e-3
    step = chords(with_equal_chords(SQUARE, 0.7e-3, SQUARE[0]))
    assert np.ptp(step) < 0.02 * step.mean()


def test_starts_stay_in_line_from_loop_to_loop() -> None:
    start = first_start(CIRCLE)
    np.testing.assert_allclose(start, [0.02, 0.0], atol=1e-9)
    for size in (0.9, 0.8, 0.5, 0.2):
        start = resample(CIRCLE * size, 0.5e-3, start)[0]
        assert np.degrees(np.arctan2(start[1], start[0])) == pytest.approx(0.0, abs=0.5)


def test_first_start_of_a_loop_that_is_not_convex_is_its_outermost_crossing() -> None:
    radius = 0.02 * (1 + 0.5 * np.cos(3 * ANGLE))
    start = first_start(radius[:, None] * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)]))
    np.testing.assert_allclose(start, [0.03, 0.0], atol=1e-6)


def test_direction_is_kept() -> None:
    points = resample(CIRCLE, 1e-3, CIRCLE[0])
    assert np.all(np.diff(np.unwrap(np.arctan2(points[:, 1], points[:, 0]))) > 0)
