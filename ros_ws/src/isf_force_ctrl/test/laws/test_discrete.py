"""Filters at the control rate, against scipy.signal."""

from __future__ import annotations

import numpy as np
import pytest
from isf_force_ctrl.laws.discrete import ramp_invariant, windowed_low_pass
from scipy.signal import cont2discrete, firwin


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0])
@pytest.mark.parametrize("taps", [3, 8, 31, 120])
@pytest.mark.parametrize("cutoff", [2.0, 10.0, 49.0, 124.0])
def test_a_low_pass_is_that_of_scipy(taps: int, cutoff: float, rate: float) -> None:
    found = windowed_low_pass(taps, cutoff, rate)
    np.testing.assert_allclose(found, firwin(taps, cutoff, fs=rate), rtol=0, atol=1e-15)
    assert found.sum() == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("cutoff", [-1.0, 0.0, 250.0, 300.0, float("nan")])
def test_a_cut_off_that_no_filter_has_is_refused(cutoff: float) -> None:
    with pytest.raises(ValueError, match="half the rate of 500 Hz"):
        windowed_low_pass(9, cutoff, 500.0)


@pytest.mark.parametrize("rate", [100.0, 500.0, 2000.0])
@pytest.mark.parametrize("bandwidth", [5.0, 20.0, 60.0])
def test_a_lag_is_that_of_scipy(bandwidth: float, rate: float) -> None:
    corner = 2 * np.pi * bandwidth
    above, below = [corner**3], [1.0, 2 * corner, 2 * corner**2, corner**3]
    numerator, denominator, _ = cont2discrete((above, below), 1.0 / rate, method="foh")
    found = ramp_invariant([1.0], [1.0, 2.0, 2.0, 1.0], corner / rate)
    np.testing.assert_allclose(found[0], np.ravel(numerator), rtol=1e-6, atol=1e-13)
    np.testing.assert_allclose(found[1], denominator, rtol=1e-9)
    assert found[0].sum() == pytest.approx(found[1].sum(), rel=1e-6)  # unit gain at rest


def test_a_zero_and_a_first_order_lag() -> None:
    for above, below in (([1.0, 3.0], [2.0, 1.0, 4.0]), ([2.0], [1.0, 5.0])):
        numerator, denominator, _ = cont2discrete((above, below), 0.1, method="foh")
        found = ramp_invariant(above, below, 0.1)
        np.testing.assert_allclose(found[0], np.ravel(numerator), atol=1e-14)
        np.testing.assert_allclose(found[1], denominator, atol=1e-14)
