"""The two published parameter sets of the force loop, and compliance compensation at rest and in motion."""

import numpy as np
import pytest
from contact_sandbox import Servo, make_config, ring, run
from isf_force_ctrl import Mode
from isf_force_ctrl.laws.force_and_compliance import ContactForceLoop

STIFFNESS = 0.45e6


def step_response(rate, loop_gain, error_slew, seconds=1.0):
    """(T,) N, 100 -> 200 N with all published limits (error clamp 64 N, dead zone 3 N) around servo and spring."""
    config = make_config(rate=rate, loop_gain=loop_gain, error_slew=error_slew, dead_zone=3.0)
    loop = ContactForceLoop(config.contact_force())
    servo = Servo(np.array([0.0]), rate)
    force, forces = 100.0, []
    for _ in range(int(seconds * rate)):
        position = servo.step(np.array([loop.control(200.0 - force)]))[0]
        force = 100.0 + STIFFNESS * position
        forces.append(force)
    return np.array(forces)


def rise(forces, rate):
    return float(np.argmax(forces >= 190.0) + 1) / rate


def test_set_of_the_text():
    # Ren 2018, 2.3.4: 440 Hz, K_i 53-55 um/(N s): 90 % in 97 ms, overshoot 1 N, at rest within 1 N. The published
    # run has a smoother of 7 ms and a servo rate of its own: 10 ms of tolerance.
    forces = step_response(440.0, 24.0, 16e-6 / 2e-6 * 440.0)
    assert rise(forces, 440.0) == pytest.approx(0.097, abs=0.010)
    assert forces.max() <= 203.0
    assert 200.0 - forces[-1] <= 3.01  # the dead zone


def test_set_of_the_listing():
    # Ren 2018, appendix B: 226 Hz, K_i 28.3 um/(N s): 90 % in 193 ms, rests 3 N short in its dead zone.
    forces = step_response(226.0, 28.3e-6 * STIFFNESS, 16e-6 / 2e-6 * 226.0)
    assert rise(forces, 226.0) == pytest.approx(0.193, abs=0.015)
    assert forces.max() <= 200.5
    assert forces[-1] == pytest.approx(197.0, abs=0.5)


@pytest.mark.parametrize(("feed", "least"), [(0.005, 0.99), (0.015, 0.99), (0.030, 0.95)])
def test_compensation_in_motion(feed, least):
    """The deflection of the forming tool that is left while it moves along a ring, whose force turns with it."""
    contour = ring(0, 1, radius=30e-3, points=300, feed=feed, force=None)
    outcome = run([contour], make_config(compensation=1.0), sheet=lambda t, a: 200.0, max_ticks=30000)
    result = outcome.results[0]
    force = result.forming_force[20:-20, :2]
    left = 1e-6 * force + result.compliance_offset[20:-20, :2]
    cut = 1.0 - np.linalg.norm(left, axis=1) / np.linalg.norm(1e-6 * force, axis=1)
    assert np.mean(cut) >= least
    assert Mode.POSITION in outcome.mode
