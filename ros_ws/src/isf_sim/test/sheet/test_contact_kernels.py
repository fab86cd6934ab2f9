"""Contact kernels against analytic geometry of balls, planes and walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_sim.sheet.contact_kernels import axial_force, envelope, probe_wall, touch_heights
from isf_sim.sheet.surface import Surface, flat_surface

R = 5e-3
SIZE = (0.06, 0.06)
H = 0.5e-3


def inclined(slope: float) -> Surface:
    """A plane z = slope x."""
    surface = flat_surface(SIZE, H)
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1])
    surface.height[:] = slope * x
    return surface


@given(st.floats(0.0, 1.5), st.floats(-5e-3, 5e-3), st.floats(-5e-3, 5e-3))
@settings(max_examples=40, deadline=None)
def test_ball_on_a_plane(slope: float, x: float, y: float) -> None:
    """The tip stands R / cos(a) - R above the plane; on a grid up to h^2 (1 + slope^2)^1.5 / (4 R) lower."""
    out = np.empty(2)
    touch_heights(inclined(slope), 0.0, 3 * R, x, y, R, out)
    exact = slope * x + R * (math.hypot(1.0, slope) - 1.0)
    error = H**2 * (1 + slope**2) ** 1.5 / (4 * R)
    assert exact - 2.0 * error <= out[1] <= exact + 1e-12
    assert out[0] == out[1]  # nothing was touched in this pass


def test_envelope_is_the_ball_and_remembers_the_surface_before_the_pass() -> None:
    surface = flat_surface(SIZE, H)
    for path, tip in ((0.0, -0.2e-3), (1e-3, -0.5e-3)):
        envelope(surface, path, 3 * R, 0.0, 0.0, tip, R)
    x = surface.x0 + surface.h * np.arange(surface.height.shape[1])
    middle = surface.height[surface.height.shape[0] // 2]
    inside = np.abs(x) < 0.9 * math.sqrt(2 * R * 0.5e-3)
    assert middle[inside] == pytest.approx(-0.5e-3 + R - np.sqrt(R**2 - x[inside] ** 2), abs=1e-12)
    assert (middle[np.abs(x) > R] == 0.0).all()
    out = np.empty(2)
    touch_heights(surface, 2e-3, 3 * R, 0.0, 0.0, R, out)
    assert out[0] == pytest.approx(0.0, abs=1e-12)  # the flat sheet of before
    assert out[1] == pytest.approx(-0.5e-3, abs=1e-12)
    touch_heights(surface, 1.0, 3 * R, 0.0, 0.0, R, out)
    assert out[0] == pytest.approx(-0.5e-3, abs=1e-12)  # a later pass meets the formed surface


def test_wall_probe_on_a_straight_wall_and_in_a_corner() -> None:
    out = np.empty(4)
    probe_wall(inclined(0.8), 0.0, 0.0, R, out)
    assert out == pytest.approx([0.8, 1.0, 0.0, 1.0], abs=0.01)  # 24 rays: the wrap integral is good to 1 %
    corner = inclined(0.0)
    x = corner.x0 + corner.h * np.arange(corner.height.shape[1])
    corner.height[:] = np.maximum(0.0, 0.8 * (x[None, :])) + np.maximum(0.0, 0.8 * (x[:, None]))
    probe_wall(corner, 0.0, 0.0, R, out)
    assert out[1:3] == pytest.approx([math.sqrt(0.5), math.sqrt(0.5)], abs=1e-6)
    assert out[3] > 1.1  # the wall wraps round the tool


@given(
    st.floats(1e-6, 5e-3),
    st.floats(50.0, 2000.0),
    st.floats(0.0, 1e-3),
    st.floats(1e-8, 1e-6),
    st.floats(20.0, 1500.0),
    st.floats(0.0, 5e-3),
    st.floats(0.3, 1.0),
)
@settings(max_examples=200, deadline=None)
def test_axial_force_solves_its_equation(
    gap: float, amplitude: float, step: float, compliance: float, guess: float, sink: float, b: float
) -> None:
    """gap = c F + S(F) + step (F/A)^(1/m), unless F is at the limit of the search, 4 A + 1."""
    m = 0.18
    force = axial_force(gap, amplitude, m, step, compliance, guess, sink, b)
    if force < 3.99 * amplitude:
        total = compliance * force + sink * (force / guess) ** b + step * (force / amplitude) ** (1 / m)
        # the search ends at a step of 1e-4 (F + 1 N): below that S(F) is not resolved; the plastic exponent is 5.6
        unresolved = compliance * 2e-4 + 2.0 * sink * (2e-4 / guess) ** b
        assert total == pytest.approx(gap, rel=2e-3, abs=unresolved + 2e-9)
    else:
        assert axial_force(0.0, amplitude, m, step, compliance, guess, sink, b) == 0.0
