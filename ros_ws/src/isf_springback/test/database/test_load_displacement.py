"""Laws through load-displacement samples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_springback.database.load_displacement import CubicLaw, cubic_law, power_law

LOADS = np.linspace(100.0, 600.0, 6)


@settings(max_examples=30, deadline=None)
@given(a=st.floats(1e-6, 1e-3), b=st.floats(0.34, 1.0))
def test_power_law_is_recovered(a, b):
    law = power_law(LOADS, a * LOADS[None] ** b)
    assert law.a[0] == pytest.approx(a, rel=1e-9)
    assert law.b[0] == pytest.approx(b, rel=1e-9)
    assert law.r_squared[0] == pytest.approx(1.0)


@settings(max_examples=30, deadline=None)
@given(a=st.floats(1e-6, 1e-4), b=st.floats(0.34, 1.0))
def test_cubic_law_rises_and_its_inverse_is_exact(a, b):
    law = cubic_law(LOADS, a * LOADS[None] ** b)
    force = np.linspace(1.0, 1500.0, 40)
    found = CubicLaw(np.repeat(law.k, 40, axis=0)).displacement(force)
    assert (np.diff(found) > 0).all()
    assert law.force(found) == pytest.approx(force, rel=1e-6)
    assert law.displacement(np.array([-50.0]))[0] == 0.0
    assert law.stiffness(found[:1])[0] == pytest.approx(
        (law.force(found[:1] + 1e-9) - law.force(found[:1] - 1e-9))[0] / 2e-9, rel=1e-4
    )


def test_table_4_6_of_the_source():
    """Z of the cone, 2.71 mm at 200 N and 5.09 mm at 600 N: a = 0.1296 mm/N^b, b = 0.5738."""
    law = power_law(np.array([200.0, 600.0]), 1e-3 * np.array([[2.71, 5.09]]))
    assert 1e3 * law.a[0] == pytest.approx(0.1296, abs=2e-4)
    assert law.b[0] == pytest.approx(0.5738, abs=2e-4)


def test_cubic_law_is_closer_than_the_power_law_on_a_shell():
    """Samples of the elastic shell at the side of a rounded pyramid, 8 mm deep (m)."""
    samples = 1e-3 * np.array([[1.108, 1.956, 2.631, 3.200, 3.699, 4.150]])
    power, cubic = power_law(LOADS, samples), cubic_law(LOADS, samples)
    error = [
        max(abs(law.displacement(np.array([f]))[0] - s) for f, s in zip(LOADS, samples[0], strict=True))
        for law in (power, cubic)
    ]
    assert error[0] > 50e-6
    assert error[1] < 10e-6
    assert power.r_squared[0] > 0.99


@pytest.mark.parametrize(
    "rows", [[1.0, 2.0, 2.0, 3.0, 4.0, 5.0], [1.0, 2.0, np.nan, 3.0, 4.0, 5.0], [-1.0, 0, 1, 2, 3, 4]]
)
def test_samples_that_do_not_rise_have_a_code(rows):
    for law in (power_law, cubic_law):
        with pytest.raises(IsfError) as failure:
            law(LOADS, 1e-3 * np.array([rows]))
        assert failure.value.code == ErrorCode.DATABASE_UNUSABLE
