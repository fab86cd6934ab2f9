"""Force forecast: the published law and the linear default."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_springback.estimators.sheet_model import TREND_LIMIT, forecast

FORCE = st.floats(0.0, 2000.0)


def test_published_law():
    # Ren 2018 eq. 4-14: 1.5 F_(i-1) - 0.5 F_(i-2)
    assert forecast(np.array([600.0, 500.0]), np.array([560.0, 540.0]), "half_step") == pytest.approx([620.0, 480.0])


def test_second_contour_holds_the_first_force():
    # Ren 2018, 4.3.1: F_pred = F1 for i = 2
    assert forecast(np.array([350.0]), None) == pytest.approx([350.0])


@pytest.mark.parametrize(("law", "lag"), [("hold", 1.0), ("half_step", 0.5), ("linear", 0.0)])
def test_lag_on_a_ramp(law, lag):
    # Ren 2018 eq. 4-14: a force rising by c per contour is forecast c/2 low by the published law; linear has no lag
    step = 40.0
    found = forecast(np.array([500.0]), np.array([500.0 - step]), law)
    assert found == pytest.approx([500.0 + step - lag * step])


@given(last=FORCE, before=FORCE, law=st.sampled_from(["hold", "half_step", "linear"]))
def test_bounded_and_never_negative(last, before, law):
    found = forecast(np.array([last]), np.array([before]), law)[0]
    # rounding only
    assert -1e-9 <= found <= last * (1 + TREND_LIMIT) + 1e-9
    assert found >= last * (1 - TREND_LIMIT) - 1e-9


def test_negative_measured_force_counts_as_zero():
    assert forecast(np.array([-30.0]), np.array([-10.0])) == pytest.approx([0.0])
