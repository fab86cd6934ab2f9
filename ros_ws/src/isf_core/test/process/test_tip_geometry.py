"""Tip geometry and thickness against the published sample program line and identities."""

import numpy as np
import pytest
from ball_gap import tool_gap
from hypothesis import given
from hypothesis import strategies as st
from isf_core.process.thickness_and_tips import forming_tip, sine_law, support_tip


def test_sample_program_line_of_ren_2018() -> None:
    """Program of Ren 2018, Appendix C: gap 0.9945 mm = sine-law gap of a 1 mm sheet at a slope of 6.009 deg; printed
    with 4 digits."""
    forming = np.array([[42.5714e-3, 0.0, -0.0825e-3]])
    support = np.array([[43.7223e-3, 0.0, -1.0166e-3]])
    gap = tool_gap(forming, support, 5e-3, 5e-3)[0]
    assert gap == pytest.approx(0.9945e-3, abs=1e-7)
    between = (support - [0, 0, 5e-3]) - (forming + [0, 0, 5e-3])
    slope = np.arctan2(between[0, 0], -between[0, 2])
    assert np.degrees(slope) == pytest.approx(6.009, abs=1e-3)
    assert sine_law(1e-3, slope) == pytest.approx(gap, abs=1e-7)


@pytest.mark.parametrize(("angle", "thickness"), [(40, 0.7660), (45, 0.7071), (50, 0.6428), (60, 0.5), (65, 0.4226)])
def test_sine_law_values(angle: float, thickness: float) -> None:
    """Sine law (Ren 2018, 1.1.2), to four digits."""
    assert sine_law(1.0, np.radians(angle)) == pytest.approx(thickness, abs=5e-5)


@given(
    slope=st.floats(0.0, 1.4),
    heading=st.floats(0.0, 6.28),
    first=st.floats(1e-3, 2e-2),
    second=st.floats(1e-3, 2e-2),
    gap=st.floats(1e-4, 3e-3),
)
def test_centre_distance_is_radii_plus_gap(
    slope: float, heading: float, first: float, second: float, gap: float
) -> None:
    """Praveen 2020 eq. 17-18: |C1 - C2| = R1 + R2 + t."""
    normal = np.array([[np.sin(slope) * np.cos(heading), np.sin(slope) * np.sin(heading), np.cos(slope)]])
    contact = np.array([[0.03, -0.02, -0.01]])
    forming = forming_tip(contact, normal, first)
    support = support_tip(contact, normal, second, gap)
    centre_1, centre_2 = forming[0] + [0, 0, first], support[0] - [0, 0, second]
    assert np.linalg.norm(centre_1 - centre_2) == pytest.approx(first + second + gap, abs=1e-9)
    assert tool_gap(forming, support, first, second)[0] == pytest.approx(gap, abs=1e-9)
