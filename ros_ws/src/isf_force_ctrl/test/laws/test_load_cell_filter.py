"""The load-cell filter: unit gain, its cut-off, the delay of the published filter."""

import numpy as np
import pytest
from isf_force_ctrl.laws.force_and_compliance import Fir, group_delay, low_pass, taps_for
from scipy.signal import freqz


@pytest.mark.parametrize("rate", [100.0, 440.0, 500.0, 1000.0, 2000.0])
def test_unit_gain_at_rest(rate):
    # The coefficients sum to one; firwin scales to rounding.
    assert low_pass(40.0, rate).sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("rate", [440.0, 500.0, 1000.0, 2000.0])
def test_delay_is_that_of_the_published_filter(rate):
    # 4 taps at 440 Hz: 1.5 samples = 3.4 ms. Whole taps allow half a sample of rounding plus that of the original.
    assert group_delay(taps_for(rate), rate) == pytest.approx(1.5 / 440.0, abs=0.75 / rate + 0.5e-3)


def test_a_long_filter_has_its_cutoff():
    # firwin's cut-off is the -6 dB point for filters long against 1/cutoff (Ren 2018, 2.3.4: 40 Hz).
    _, response = freqz(low_pass(40.0, 500.0, taps=61), worN=[40.0], fs=500.0)
    assert abs(response[0]) == pytest.approx(0.5, abs=0.01)


def test_published_filter_numbers():
    # Ren 2018, appendix B: [71, 185, 185, 71]/512 is -3 dB at 63.6 Hz for 440 Hz; ours with as many taps is close to
    # it.
    _, published = freqz(np.array([71, 185, 185, 71]) / 512, worN=[63.6], fs=440.0)
    assert abs(published[0]) == pytest.approx(np.sqrt(0.5), abs=0.005)
    assert low_pass(40.0, 440.0) == pytest.approx(np.array([71, 185, 185, 71]) / 512, abs=0.1)


def test_streaming_equals_convolution():
    coefficients = low_pass(40.0, 500.0)
    values = np.random.default_rng(1).standard_normal(50)
    fir = Fir(coefficients)
    streamed = [fir.step(v) for v in values]
    assert streamed == pytest.approx(np.convolve(values, coefficients)[:50], abs=1e-12)


def test_reset_forgets():
    fir = Fir(low_pass(40.0, 500.0))
    fir.step(100.0)
    fir.reset(7.0)
    assert fir.step(7.0) == pytest.approx(7.0)
