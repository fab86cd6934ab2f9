"""Stability limits against the published analysis (Ren 2018, 2.3.3)."""

import re

import numpy as np
import pytest
from contact_sandbox import make_config
from hypothesis import given
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_force_ctrl import ForceController
from isf_force_ctrl.laws.stability import check_compliance_gain, servo_response, ultimate_loop_gain


def test_servo_is_down_3_db_at_its_bandwidth():
    assert abs(servo_response(30.0, np.array([2 * np.pi * 30.0]))[0]) == pytest.approx(np.sqrt(0.5), rel=1e-9)


def test_ultimate_gain_of_integral_control():
    # Derived for the Butterworth servo alone: 141 1/s at 21.2 Hz. For s^3+2ws^2+2w^2s+w^3 the phase of G is -90 deg at
    # w/sqrt(2); |G| there is 2 sqrt(2)/3 * ..., checked here by the closed form w_u = w/sqrt(2), K = w_u/|G(j w_u)|.
    w = 2 * np.pi * 30.0
    at = w / np.sqrt(2.0)
    exact = at / abs(servo_response(30.0, np.array([at]))[0])
    assert ultimate_loop_gain(30.0) == pytest.approx(exact, rel=2e-3)  # grid of 8000 frequencies
    assert ultimate_loop_gain(30.0) == pytest.approx(141.0, abs=1.0)


def test_filter_hold_and_smoother_of_the_original():
    # 1.5 samples FIR + 1 sample hold at 440 Hz + 7 ms smoother: about 75 1/s. A pure delay stands for the smoother
    # (a first-order lag, which also attenuates), so the limit found here must be lower, by no more than a quarter.
    delay = 2.5 / 440.0 + 7e-3
    assert 75.0 * 0.75 < ultimate_loop_gain(30.0, delay) < 75.0


@given(st.floats(0.0, 0.95), st.floats(0.0, 0.01))
def test_compensation_and_delay_cost_margin(compensation, delay):
    assert ultimate_loop_gain(30.0, delay, compensation) <= ultimate_loop_gain(30.0) * 1.001  # grid of frequencies


def test_infinite_without_servo_lag():
    assert ultimate_loop_gain(1e9) > 1e6


@given(st.floats(1e-9, 1e-5), st.floats(1e4, 1e7))
def test_compliance_guard(gain, stiffness):
    # Ren 2018 eq. 2-12: stable only for K_p K_c < 1.
    if gain * stiffness < 1.0:
        check_compliance_gain(gain, stiffness)
    else:
        with pytest.raises(IsfError) as caught:
            check_compliance_gain(gain, stiffness)
        assert caught.value.code is ErrorCode.UNSTABLE_GAIN


def test_compensating_both_tools_with_a_small_error_is_refused():
    # Ren 2018, 2.3.3: 1 um/N each on K_c = 0.45 N/um gives 0.9; 12 % too much makes it unstable.
    check_compliance_gain(2.0e-6, 0.45e6)
    with pytest.raises(IsfError, match="UNSTABLE_GAIN"):
        check_compliance_gain(2.0e-6 * 1.12, 0.45e6)


def test_published_gain_has_its_margin_with_compensation():
    # 7.2 of the source's Chapter-2/7 analysis: nominal coupled gain 0.45; we ask for a gain margin of 1.5 and have 2.3.
    make_config(compensation=1.0).check()
    with pytest.raises(IsfError, match="UNSTABLE_GAIN"):
        ForceController(make_config(compensation=1.0, loop_gain=60.0))


def test_the_advice_for_a_slow_servo_is_enough_and_no_more():
    """A servo of 10 Hz, as of the arms, at 100 Hz: both numbers of the text are taken, a little less is not."""
    slow = {"servo_bandwidth": 10.0, "compensation": 0.0, "support_compensation": 0.0}
    with pytest.raises(IsfError) as caught:
        make_config(rate=100.0, **slow).check()
    assert "servo of 10 Hz and 25 ms of delay" in caught.value.what
    gain, rate = (float(word) for word in re.findall(r"to (\d+) (?:1/s|Hz)", caught.value.advice))
    make_config(rate=100.0, loop_gain=gain, **slow).check()
    make_config(rate=rate, **slow).check()
    for nearly in ({"rate": 100.0, "loop_gain": gain + 1.0}, {"rate": rate - 10.0}):
        with pytest.raises(IsfError):
            make_config(**nearly, **slow).check()
