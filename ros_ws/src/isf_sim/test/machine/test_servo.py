"""Servo: bandwidth and constants of Ren 2018, 2.3.3, and exactness of the discrete form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_sim.machine.axes import follow_targets, make_servo, natural_frequency


def test_three_decibel_at_thirty_hertz() -> None:
    """wn = 233 rad/s and p = 372 rad/s for 30 Hz with damping 0.75 and p/wn = 1.6."""
    wn = natural_frequency(30.0, 0.75, 1.6)
    assert wn == pytest.approx(233.0, rel=0.005)
    s = 2j * np.pi * 30.0
    p = 1.6 * wn
    assert abs(p * wn**2 / ((s + p) * (s**2 + 1.5 * wn * s + wn**2))) == pytest.approx(np.sqrt(0.5), rel=1e-9)


def test_rate_is_the_nearest_multiple_of_the_control_rate() -> None:
    for control_rate, substeps in ((500.0, 4), (440.0, 5), (2000.0, 1)):
        assert make_servo(30.0, 2200.0, control_rate, 0.75, 1.6).substeps == substeps


def test_ramp_is_followed_at_the_lag_of_the_continuous_loop() -> None:
    """Steady velocity lag of G is 1/p + 2 zeta/wn seconds; the first-order hold adds half a servo period."""
    servo = make_servo(30.0, 2200.0, 500.0, 0.75, 1.6)
    wn = natural_frequency(30.0, 0.75, 1.6)
    axes, velocity = np.zeros((1, 3)), 0.03
    for k in range(500):
        follow_targets(axes, np.array([velocity * k / 500]), np.array([velocity * (k + 1) / 500]), servo)
    lag = velocity - axes[0, 0]
    # targets lead the zero-order hold of one servo step (0.5 ms) by half of it
    assert lag == pytest.approx(velocity * (1 / (1.6 * wn) + 1.5 / wn - 0.25e-3), rel=0.01)


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
@settings(max_examples=30, deadline=None)
def test_reaches_a_held_target_and_stays(start: float, target: float) -> None:
    servo = make_servo(30.0, 2200.0, 500.0, 0.75, 1.6)
    axes = np.array([[start, 0.0, 0.0]])
    for _ in range(200):  # 0.4 s, more than 60 time constants of the slowest pole
        follow_targets(axes, np.array([target]), np.array([target]), servo)
    assert axes[0] == pytest.approx([target, 0.0, 0.0], abs=1e-9)
