"""Curvatures by Pratt's circle, wall angle, stretches: the features that the source names."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_springback.database.loop_features import loop_features, pratt_circle
from loop_parts import arc, contour_of, rounded_square

TOOL = 5e-3


@settings(max_examples=30, deadline=None)
@given(
    radius=st.floats(1e-3, 1.0),
    x=st.floats(-0.1, 0.1),
    y=st.floats(-0.1, 0.1),
    start=st.floats(0, 360),
    span=st.floats(20, 300),
)
def test_pratt_finds_exact_circles(radius, x, y, start, span):
    turn = np.radians(start + np.linspace(0, span, 11))
    points = np.array([x, y]) + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    centre, curvature = pratt_circle(points[None])
    assert curvature[0] * radius == pytest.approx(1.0, rel=1e-4)
    assert np.linalg.norm(centre[0] - [x, y]) < 2e-4 * radius


def test_pratt_on_a_line_has_no_curvature():
    points = np.column_stack([np.linspace(0, 1e-2, 11), np.linspace(0, 3e-3, 11)])
    assert pratt_circle(points[None])[1][0] < 1e-3


@pytest.mark.parametrize("radius", [10e-3, 36e-3, 100e-3])
def test_curvature_of_a_circle_times_tool_radius(radius):
    """The features of Ren 2018, 4.2.5: kappa R within 1 %; convex whichever way the path runs."""
    ring = arc((0, 0), radius, 0, 360)[:-1]
    for line in (ring, ring[::-1]):
        features = loop_features(contour_of(line, 5e-3), TOOL)
        assert features.curvature * TOOL == pytest.approx(TOOL / radius, rel=0.01)
        assert features.wall_angle == pytest.approx(np.radians(45))


def test_concave_arcs_are_negative_on_a_loop_that_is_not_star_shaped():
    """A C: the sign by the loop's mean point, as published, would be wrong in its hollow."""
    outer, inner = arc((0, 0), 40e-3, 30, 330), arc((0, 0), 25e-3, 330, 30)
    contour = contour_of(np.vstack([outer, inner]), 5e-3)
    features = loop_features(contour, TOOL)
    distance = np.linalg.norm(contour.contact[:, :2], axis=1)
    turn = np.abs(np.degrees(np.arctan2(contour.contact[:, 1], -contour.contact[:, 0])))
    middle = turn < 120
    assert np.allclose(features.curvature[middle & (distance > 39e-3)], 1 / 40e-3, rtol=0.01)
    assert np.allclose(features.curvature[middle & (distance < 26e-3)], -1 / 25e-3, rtol=0.01)


def test_sharp_corner_is_a_peak_and_straights_are_zero():
    contour = contour_of(rounded_square(40e-3, 0.0), 5e-3)
    features = loop_features(contour, TOOL)
    to_corner = np.abs(np.abs(contour.contact[:, :2]) - 40e-3).max(axis=1)
    assert np.abs(features.curvature[to_corner > 8e-3]).max() * TOOL < 1e-3
    assert features.curvature[to_corner < 0.3e-3].min() * TOOL > 0.5


def test_curvature_across_loops_is_that_of_the_wall_profile():
    """A dome of radius R cut by levels: rho_2 = R, flattening downwards is negative."""
    radius = 80e-3
    loops = []
    for angle in np.radians([48.0, 45.0, 42.0]):
        ring = arc((0, 0), radius * np.sin(angle), 0, 360)[:-1]
        loops.append(contour_of(ring, radius * np.cos(angle)))
    features = loop_features(loops[1], TOOL, (loops[0], loops[2]))
    # the nearest point of the next loop is up to half a step aside
    assert np.median(features.across) * radius == pytest.approx(-1.0, rel=1e-3)
    assert features.across * radius == pytest.approx(-1.0, rel=0.05)
    assert (loop_features(loops[1], TOOL).across == 0.0).all()
