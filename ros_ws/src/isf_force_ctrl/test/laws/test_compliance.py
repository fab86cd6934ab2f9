"""Compliance compensation of the forming tool (Ren 2018, 2.3.1, 2.3.3)."""

import numpy as np
import pytest
from contact_sandbox import Servo, make_config
from hypothesis import given
from hypothesis import strategies as st
from isf_force_ctrl.control_state import Flag
from isf_force_ctrl.laws.force_and_compliance import ComplianceCompensation


def pull(force, factor, ticks=1500):
    """m, error of the tip left after pulling with ``force`` N at a tool of 1 um/N."""
    config = make_config(compensation=factor)
    compensation = ComplianceCompensation(config.compliance())
    servo = Servo(np.zeros(2))
    tip = np.zeros(2)
    for _ in range(ticks):
        compensation.step(*force)
        tip = servo.step(np.array([compensation.x, compensation.y])) + 1e-6 * np.array(force)
    return tip


def test_pull_test():
    # Ren 2018, 2.4: 100 N at 1 um/N deflects 100 um; up to 95 % less with compensation. Ours is exact at rest.
    assert np.linalg.norm(pull((100.0, 0.0), 1.0)) <= 5e-6
    assert pull((60.0, -80.0), 0.0) == pytest.approx([60e-6, -80e-6])


def test_partial_compensation():
    # 2.7: a factor of 0.5 leaves half.
    assert pull((100.0, -50.0), 0.5) == pytest.approx([50e-6, -25e-6], abs=1e-9)


def coupled(product, ticks=3000):
    """(T,) N, response of compensation and contact spring to 1 N, K_p K_c = ``product``; no limits, no smoothing."""
    config = make_config(
        compensation=1.0,
        forming_compliance=(product / 0.45e6,) * 2,
        compliance_slew=1e9,
        offset_limit=1e9,
        compliance_time=0.0,
    )
    compensation = ComplianceCompensation(config.compliance())
    servo = Servo(np.zeros(1))
    force, forces = 1.0, []
    for _ in range(ticks):
        compensation.step(-force, 0.0)
        force = 1.0 + 0.45e6 * servo.step(np.array([compensation.x]))[0]
        forces.append(force)
    return np.array(forces)


@pytest.mark.parametrize("product", [0.45, 0.90])
def test_stable_below_one(product):
    # Loop of Ren 2018 eq. 2-12: poles at -76.7 and -9.9 1/s; the force settles at 1/(1 - K_p K_c).
    forces = coupled(product)
    assert forces[-1] == pytest.approx(1.0 / (1.0 - product), rel=0.01)


@pytest.mark.parametrize("product", [1.02, 1.10])
def test_unstable_above_one(product):
    # The same loop: +0.94 1/s at 1.01 and +9.0 1/s at 1.10: grows without bound.
    forces = coupled(product)
    assert forces[-1] > 2 * forces[len(forces) // 2] > 0


@given(st.lists(st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000)), min_size=2, max_size=150))
def test_offset_is_limited_and_slew_limited(forces):
    config = make_config(compensation=1.0)
    compensation = ComplianceCompensation(config.compliance())
    offsets = [(0.0, 0.0)]
    for k, force in enumerate(forces):
        compensation.step(*force) if k % 20 else compensation.freeze()
        offsets.append((compensation.x, compensation.y))
    step = np.abs(np.diff(offsets, axis=0)).max()
    assert step <= config.compliance_slew / config.rate * (1 + 1e-9)
    assert np.abs(offsets).max() <= config.offset_limit * (1 + 1e-9)


def test_saturation_is_reported():
    compensation = ComplianceCompensation(make_config(compensation=1.0).compliance())
    compensation.step(5000.0, 0.0)
    assert compensation.flags & Flag.SATURATED_COMPLIANCE
    compensation = ComplianceCompensation(make_config(compensation=1.0).compliance())
    compensation.step(1.0, 0.0)
    assert not compensation.flags


def test_fast_forces_are_left_to_the_tool():
    # First-order, 0.2 s: at 4 Hz the gain is 1/sqrt(1 + (2 pi 4 0.2)^2) = 0.195; FIR and sampling change it by < 5 %.
    config = make_config(compensation=1.0)
    compensation = ComplianceCompensation(config.compliance())
    offsets = []
    for k in range(2000):
        compensation.step(20.0 * np.sin(2 * np.pi * 4.0 * k / config.rate), 0.0)
        offsets.append(compensation.x)
    assert np.ptp(offsets[1000:]) / 2 == pytest.approx(20e-6 * 0.195, rel=0.05)


@pytest.mark.parametrize("turn", [0.5, 1.5, 3.0])
def test_a_force_that_turns_with_the_contour_is_followed(turn):
    """3 rad/s is a ring of 10 mm at 30 mm/s; in x and y a first-order lag of 0.2 s would leave wT = 0.6 of it."""
    config = make_config(compensation=1.0)
    compensation = ComplianceCompensation(config.compliance())
    for k in range(2000):
        angle = turn * k / config.rate
        normal = np.array([np.cos(angle), np.sin(angle)])
        force = -150.0 * normal + 30.0 * np.array([-normal[1], normal[0]])
        compensation.step(*force, *normal)
    left = 1e-6 * force + [compensation.x, compensation.y]
    # what is left is the delay of the FIR of 4 ms
    assert np.linalg.norm(left) <= 1.2 * 1e-6 * np.linalg.norm(force) * turn * 0.006 + 1e-9


def test_a_turning_normal_alone_changes_nothing():
    compensation = ComplianceCompensation(make_config(compensation=1.0).compliance())
    for k in range(500):
        compensation.step(0.0, 0.0, np.cos(0.1 * k), np.sin(0.1 * k))
    assert (compensation.x, compensation.y) == (0.0, 0.0)
