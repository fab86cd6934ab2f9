"""Radii of the opening and of the clamp."""

import numpy as np
import pytest
from isf_core.geometry.opening import SMALLEST_GAP, Opening, clamp_radius

TURN = np.linspace(0, 2 * np.pi, 500, endpoint=False)
CIRCLE = np.column_stack([np.cos(TURN), np.sin(TURN)])


def square(half, count=400):
    """Outline of a square by equal steps."""
    s = np.linspace(0, 8 * half, count, endpoint=False)
    side, rest = (s // (2 * half)).astype(int), s % (2 * half) - half
    table = np.array([[half, 1, 0, 1], [half, 1, -1, 0], [-half, 1, 0, -1], [-half, 1, 1, 0]])
    along = np.where(side % 2 == 0, rest * table[side, 3], rest * table[side, 2])
    across = table[side, 0]
    return np.where((side % 2 == 0)[:, None], np.column_stack([across, along]), np.column_stack([along, across]))


def test_circle_off_centre():
    opening = Opening.of(0.03 * CIRCLE + [0.02, -0.01])
    assert opening.centre == pytest.approx([0.02, -0.01], abs=1e-6)
    # chords of 500 points sag by 2e-5 of the radius
    assert opening.radius_towards(0.01 * CIRCLE + [0.02, -0.01]) == pytest.approx(np.full(500, 0.03), rel=1e-4)


def test_square_opening_has_a_local_radius():
    opening = Opening.of(square(0.04))
    towards = opening.radius_towards(np.array([[0.01, 0.0], [0.01, 0.01]]))
    # interpolated over directions of 1 deg: the corner is cut by less than 1 %
    assert towards == pytest.approx([0.04, 0.04 * np.sqrt(2)], rel=0.01)


def test_equivalent_clamp_radius():
    # a = 141 mm gives the area of the 250 mm square (Ren 2018, 4.3.2)
    opening = Opening.of(0.036 * CIRCLE)
    found = clamp_radius(opening, 0.036 * CIRCLE, (0.25, 0.25), "equivalent")
    assert found == pytest.approx(np.full(500, 0.141), abs=0.0005)


def test_local_clamp_radius_of_an_off_centre_part():
    opening = Opening.of(0.03 * CIRCLE + [0.05, 0.0])
    points = np.array([[0.08, 0.0], [0.02, 0.0], [0.05, 0.03], [0.06, 0.01]])
    found = clamp_radius(opening, points, (0.25, 0.2), "local")
    assert found == pytest.approx([0.075, 0.175, 0.1, 0.075 * np.sqrt(2)], rel=1e-4)


@pytest.mark.parametrize("kind", ["equivalent", "local"])
def test_the_clamp_stays_outside_the_opening(kind):
    loop = square(0.124)
    opening = Opening.of(loop)
    found = clamp_radius(opening, loop, (0.25, 0.25), kind)
    assert (found * (1 - SMALLEST_GAP) >= opening.radius_towards(loop) - 1e-12).all()
