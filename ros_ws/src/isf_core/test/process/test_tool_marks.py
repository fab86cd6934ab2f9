"""Distance of tool marks and height of the ridges between them, against published and tabulated numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_core.process.forming_force import scallop_height
from isf_core.process.tool_marks import mark_spacing, ridge_height, spacing_of_ridge, step_of_spacing

MM = 1e-3


@pytest.mark.parametrize(("step", "computed", "measured"), [(0.6, 0.783, 0.751), (1.1, 1.436, 1.406)])
def test_marks_of_the_published_cone(step: float, computed: float, measured: float) -> None:
    """Cone of 50 deg, tool of 30 mm (Lu 2016, 4.1.2): measured marks are closer by 2.1 and 4.1 %."""
    spacing = float(mark_spacing(step * MM, np.radians(50.0))) / MM
    assert spacing == pytest.approx(computed, abs=0.0006)
    assert 0.95 < measured / spacing < 0.985


@pytest.mark.parametrize(("step", "ridge"), [(0.1, 0.00014), (0.6, 0.0051), (1.1, 0.0172), (2.0, 0.0569)])
def test_ridges_of_the_published_cone(step: float, ridge: float) -> None:
    """Tool radius 15 mm, wall of 50 deg; the last digit is rounded."""
    found = float(ridge_height(mark_spacing(step * MM, np.radians(50.0)), 15 * MM)) / MM
    assert found == pytest.approx(ridge, abs=5.1e-6 if ridge < 0.001 else 5.1e-5)


@pytest.mark.parametrize(
    ("step", "ridges"),
    [
        (0.5, [0.905, 0.212, 0.094, 0.035, 0.025, 0.0125, 0.0083, 0.0064]),
        (0.25, [0.210, 0.052, 0.023, 0.0088, 0.0063, 0.0031, 0.0021, 0.0016]),
    ],
)
def test_ridges_over_the_wall_angle(step: float, ridges: list[float]) -> None:
    """Tool of 10 mm (Behera 2015, sequencing): shallow zones get far higher ridges at one depth step."""
    angles = np.radians([5, 10, 15, 25, 30, 45, 60, 80])
    found = ridge_height(mark_spacing(step * MM, angles), 5 * MM) / MM
    np.testing.assert_allclose(found, ridges, rtol=0.03)


def test_passes_that_do_not_meet_leave_what_lay_between_them() -> None:
    assert ridge_height(10.01 * MM, 5 * MM) == pytest.approx(5 * MM)
    assert ridge_height(1e3, 5 * MM) == pytest.approx(5 * MM)


@given(st.floats(1e-6, 9.9e-3), st.floats(5e-3, 30e-3), st.floats(0.05, 1.55))
def test_the_step_for_a_wanted_ridge_leaves_it(height: float, radius: float, angle: float) -> None:
    height = min(height, 0.99 * radius)
    step = step_of_spacing(spacing_of_ridge(height, radius), angle)
    assert float(ridge_height(mark_spacing(step, angle), radius)) == pytest.approx(height, rel=1e-6)


@given(st.floats(1e-5, 1e-3), st.floats(3e-3, 30e-3), st.floats(0.3, 1.5))
def test_low_ridges_are_those_of_the_force_regression(step: float, radius: float, angle: float) -> None:
    exact, low = ridge_height(mark_spacing(step, angle), radius), scallop_height(step, radius, angle)
    assert low <= exact <= 1.15 * low
