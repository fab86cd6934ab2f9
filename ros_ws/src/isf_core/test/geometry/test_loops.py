"""Places inside plane loops: against shapely, on random shapes, and by hand on a square."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from isf_core.geometry.loops import area_of, inside_loops, reach_to_loops

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def star(seed: int, centre: tuple[float, float]) -> np.ndarray:
    """A loop with reentrant corners, of 5 to 30 corners."""
    random = np.random.default_rng(seed)
    angle = np.sort(random.uniform(0.0, 2.0 * np.pi, random.integers(5, 31)))
    radius = random.uniform(0.3, 1.0, len(angle))
    return np.array(centre) + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


@given(st.integers(0, 2**31))
def test_distances_and_sides_are_those_of_shapely(seed: int) -> None:
    loops = [star(seed, (0.0, 0.0)), star(seed + 1, (2.5, 0.3))]
    x, y = np.random.default_rng(seed).uniform(-1.5, 4.0, (2, 7, 9))
    whole = shapely.MultiPolygon([shapely.Polygon(loop) for loop in loops])
    distance = shapely.distance(shapely.points(x, y), whole.boundary)
    expected = np.where(shapely.contains_xy(whole, x, y), distance, -distance)
    np.testing.assert_allclose(inside_loops(loops, x, y), expected, atol=1e-12)


def test_reach_is_to_the_first_side_ahead() -> None:
    points, ways = (
        np.array([[0.0, 0.5], [0.0, 0.5], [-3.0, 0.0], [-3.0, 0.0]]),
        np.array([[1, 0], [0, 1], [1, 0], [-1, 0]]),
    )
    reach = reach_to_loops([SQUARE], points, ways.astype(float))
    assert reach == pytest.approx([1.0, 0.5, 2.0, np.inf])


def test_area_tells_the_turn() -> None:
    assert (area_of(SQUARE), area_of(SQUARE[::-1])) == (4.0, -4.0)
