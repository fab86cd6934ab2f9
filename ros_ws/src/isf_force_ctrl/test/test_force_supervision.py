"""What watches and tunes the force loop at run time: oscillation, contact stiffness, set-points along a contour."""

import numpy as np
import pytest
from contact_sandbox import make_config, ring, run
from isf_force_ctrl import Mode
from isf_force_ctrl.control_laws import OscillationMonitor, StiffnessEstimate
from isf_force_ctrl.control_state import Flag
from isf_force_ctrl.laws.force_and_compliance import Fir

RATE = 500.0


def sine(frequency, amplitude, seconds, rate=RATE):
    return amplitude * np.sin(2 * np.pi * frequency * np.arange(round(seconds * rate)) / rate)


@pytest.mark.parametrize("frequency", [8.0, 12.0, 20.0])
def test_oscillation_is_found_within_half_a_second(frequency):
    monitor = OscillationMonitor(RATE, 15.0)
    for error in sine(frequency, 20.0, 0.5):
        monitor.step(error)
    assert monitor.found >= 1
    assert monitor.scale <= 0.6


@pytest.mark.parametrize(
    "error",
    [
        sine(2.0, 40.0, 10.0),  # slow: corners of a part
        sine(12.0, 6.0, 10.0),  # small
        np.random.default_rng(0).normal(0.0, 2.5, 5000),  # noise of 1 % at 250 N, unfiltered
        np.where(np.arange(5000) % 400 < 200, 60.0, -60.0),  # set-points of walls
    ],
)
def test_what_is_no_oscillation_is_left_alone(error):
    monitor = OscillationMonitor(RATE, 15.0)
    for value in error:
        monitor.step(float(value))
    assert (monitor.found, monitor.scale) == (0, 1.0)


def test_gain_recovers_when_it_is_calm():
    monitor = OscillationMonitor(RATE, 15.0)
    for error in sine(12.0, 20.0, 0.5):
        monitor.step(error)
    lowered = monitor.scale
    for _ in range(int(2.0 * RATE)):
        monitor.step(0.0)
    assert monitor.scale < 1.0  # not at once
    for _ in range(int(60.0 * RATE)):
        monitor.step(0.0)
    assert lowered < 1.0
    assert monitor.scale == 1.0


def tail_spread(outcome):
    force = outcome.force[outcome.mode == Mode.CONTROL]
    return force[len(force) // 2 :].std()


def test_a_contact_seven_times_stiffer_is_calmed():
    # The sandbox, without compliance compensation, oscillates from six times the nominal stiffness on.
    seen = []

    def on_tick(tick, controller, wrench_1, wrench_2):
        seen.append(controller.state().flags)
        return wrench_1, wrench_2

    def formed(swing, watch=None):
        config = make_config(oscillation_swing=swing, feed_error=np.inf)
        return run([ring(0, 1, radius=25e-3)], config, contact_stiffness=7 * 0.45e6, noise=False, on_tick=watch)

    alone, watched = formed(np.inf), formed(15.0, on_tick)
    assert alone.results[0].backoffs == 0
    assert watched.results[0].backoffs >= 1
    assert any(flags & Flag.OSCILLATION for flags in seen)
    assert tail_spread(alone) > 100.0
    assert tail_spread(watched) < 5.0


def test_no_backoff_at_the_nominal_stiffness():
    outcome = run([ring(k, 2) for k in range(2)], make_config(compensation=1.0), sheet=lambda t, a: 150.0)
    assert [result.backoffs for result in outcome.results] == [0, 0]


WALLS = np.where((np.arange(160) // 40) % 2 == 1, 200.0, 100.0)


@pytest.mark.parametrize("stiffness", [0.5, 1.0, 2.0])
def test_stiffness_is_found_from_changes_of_the_set_point(stiffness):
    contour = ring(0, 1, radius=25e-3, support_force=WALLS)
    outcome = run([contour], make_config(adapt_stiffness=True), contact_stiffness=stiffness * 0.45e6)
    found = outcome.controller._laws.contact_stiffness
    assert found == pytest.approx(stiffness * 0.45e6, rel=0.15)


def test_stiffness_is_not_learned_from_disturbances():
    # The offset answers the gap; force over offset would be the negative controller, not the contact.
    gap = lambda time, angle: 0.2e-3 * np.sin(3 * angle)  # noqa: E731
    outcome = run([ring(0, 1, radius=25e-3)], make_config(adapt_stiffness=True), gap=gap)
    assert outcome.controller._laws.contact_stiffness == pytest.approx(0.45e6, rel=0.25)


def test_estimate_keeps_its_bounds():
    estimate = StiffnessEstimate(0.45e6, RATE, 30.0, Fir(np.array([1.0])))
    for tick in range(2000):
        estimate.step(1e-4 * (tick % 100) / 100.0, -500.0 * tick, moving=True)
    assert estimate.value == pytest.approx(0.3 * 0.45e6)


def test_steps_between_walls():
    """100 -> 200 N settles to +-10 N within 0.3 s, overshoot below 10 % of the step."""
    outcome = run([ring(0, 1, radius=30e-3, support_force=WALLS)], make_config(), noise=False)
    force = outcome.force[outcome.mode == Mode.CONTROL]
    rises = np.flatnonzero((force[1:] > 102.0) & (force[:-1] <= 102.0))
    assert len(rises) == 2
    for rise in rises:
        after = force[rise : rise + 300]
        assert np.flatnonzero(np.abs(after - 200.0) > 10.0)[-1] <= 0.3 * RATE
        assert after.max() <= 210.0


def test_set_points_change_while_forming():
    """Set-points and the gap change at once at every wall: what is applied stays inside the limits of force."""
    outcome = run(
        [ring(0, 1, radius=25e-3, support_force=WALLS)], make_config(compensation=1.0), sheet=lambda t, a: 100.0
    )
    result = outcome.results[0]
    engaged = result.tick_engaged
    assert result.completed
    assert result.contact_fraction == 1.0
    assert set(np.round(result.tick_set_point[engaged][[400, -400]])) <= {100.0, 200.0}
    error = np.abs(result.tick_normal_force - result.tick_set_point)[engaged]
    assert np.mean(error <= 20.0) > 0.99
