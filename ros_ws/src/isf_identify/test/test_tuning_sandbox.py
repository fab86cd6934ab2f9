"""The tuning sandbox says about the laws what the source says, and its margins are those of its own runs."""

import numpy as np
import pytest
from contact_sandbox import make_config
from isf_identify.figures import draw_margin, draw_responses
from isf_identify.tuning import Plant, corner_case, gain_margin, margin_map, ramp_case, respond, step_case

NOMINAL = Plant(0.45e6, noise=0.0)


def test_integral_law():
    response = respond(make_config(), NOMINAL, step_case())
    assert response.settling() < 0.3
    assert response.overshoot() < 10.0
    assert response.force[-1] == pytest.approx(200.0, abs=1.01)  # the dead zone


def test_proportional_law_leaves_an_error():
    # Ren 2018, 2.3.3: 1 / (1 + K_p K_c) of the step is left: 50 N at 1.
    response = respond(make_config(), NOMINAL, step_case(), "P")
    assert 200.0 - response.force[-1] == pytest.approx(50.0, abs=1.0)


def test_proportional_law_becomes_unstable():
    # Proportional law of Ren 2018, 2.3.3: from K_p K_c = 3 on with the servo alone; filter and hold take some of it.
    config = make_config(oscillation_swing=np.inf)
    assert np.ptp(respond(config, NOMINAL, step_case(), "P", p_gain=1.0).force[-200:]) < 1.0
    assert np.ptp(respond(config, NOMINAL, step_case(), "P", p_gain=3.0).force[-200:]) > 50.0


def test_proportional_part_makes_it_oscillate():
    # Ren 2018, 2.3.4: PI is oscillatory.
    config = make_config(oscillation_swing=np.inf)
    integral = respond(config, NOMINAL, step_case()).force[-300:]
    both = respond(config, NOMINAL, step_case(), "PI", p_gain=2.0).force[-300:]
    assert np.ptp(both) > 10.0 * max(np.ptp(integral), 0.1)


def test_ramp_error_is_that_of_theory():
    # Ramp through the integral law: (d eps / dt) / K_i + dead zone: 300 / 53.3 + 1 = 6.6 N
    assert respond(make_config(), NOMINAL, ramp_case(300e-6)).largest_error() == pytest.approx(6.6, abs=0.5)


def test_corner_error_grows_with_the_opening():
    small, large = (respond(make_config(), NOMINAL, corner_case(size)).largest_error() for size in (20e-6, 60e-6))
    assert small < 10.0 < large


def test_margin_of_the_model_is_that_of_the_run():
    config = make_config(oscillation_swing=np.inf, error_clamp=1e9, error_slew=1e12, dead_zone=0.0)
    margin = gain_margin(config, 0.45e6, 0.01)
    for share, stable in ((0.8, True), (1.25, False)):
        response = respond(
            make_config(loop_gain=24.0 * margin * share, oscillation_swing=np.inf, dead_zone=0.0, error_slew=1e12),
            Plant(0.45e6, delay=0.01, noise=0.0),
            step_case(20.0),
        )
        assert bool(np.ptp(response.force[-100:]) < 2.0) is stable


def test_margins_over_stiffness_and_delay():
    config = make_config(compensation=1.0)
    margin = margin_map(config, np.array([0.2e6, 0.45e6, 0.9e6, 2.0e6]), np.array([0.0, 0.01, 0.02]))
    assert (np.diff(margin, axis=0) <= 1e-9).all()  # delay never helps
    assert (np.diff(margin, axis=1) <= 1e-9).all()  # nor does stiffness
    assert margin[0, 1] > 3.0
    assert margin[2, 1] > 1.5  # nominal contact, 20 ms: still allowed
    assert margin[0, 3] == 0.0  # K_p K_c >= 1


def test_monitor_calms_a_sandbox_that_oscillates():
    plant = Plant(2.0e6, delay=0.02, noise=0.0)
    config = make_config(oscillation_swing=15.0)
    assert gain_margin(config, 2.0e6, 0.02) < 1.0
    response = respond(config, plant, step_case())
    assert response.backoffs >= 1
    assert np.ptp(response.force[-100:]) < np.ptp(respond(
        make_config(oscillation_swing=np.inf), plant, step_case()
    ).force[-100:])  # fmt: skip


def test_pictures(tmp_path):
    for picture in (
        draw_responses(make_config(), NOMINAL, tmp_path / "responses.png"),
        draw_margin(make_config(compensation=1.0), tmp_path / "margin.png"),
    ):
        assert picture.read_bytes().startswith(b"\x89PNG")
