"""Legs that move: following, compliance, transducers, and every fault that can be switched on."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from isf_core.files.hydraulic_legs import OF_ONE_LEG, LegFault
from isf_core.files.rig import Rig, load_rig
from isf_core.geometry.kinematics import UPRIGHT
from isf_core.geometry.tool_axis import tilt_of
from isf_sim.legs import legs as lg
from isf_sim.legs import tuning
from isf_sim.variant import Variant, make_variant

RIG = load_rig("torrao2013")
RATE, BALL = 500.0, 5e-3
HERE, FREE = np.array([0.02, 0.0, -0.01]), np.zeros(3)


def rig_with(**changes: Any) -> Rig:
    """The published rig with other ``legs``; a mapping changes fields of a section."""
    assert RIG.legs is not None
    values = {
        name: getattr(RIG.legs, name).model_copy(update=value) if isinstance(value, dict) else value
        for name, value in changes.items()
    }
    return RIG.model_copy(update={"legs": RIG.legs.model_copy(update=values)})


def legs_of(rig: Rig = RIG, variant: Variant | None = None) -> lg.Legs:
    return lg.Legs(rig, variant or Variant(), RATE, HERE, BALL, (0, 0, 4))


def rest(legs: lg.Legs, ticks: int, force: np.ndarray = FREE, start: int = 0) -> int:
    """Hold; the bits found first."""
    for tick in range(start, start + ticks):
        if found := legs.move(HERE, UPRIGHT, force, tick):
            return found
    return 0


def test_the_default_controller_follows_within_50_um_at_constant_speed() -> None:
    """At the speed of the cone's job; the published one, with gains that do not swing, lags by some tenths of 1 mm."""
    case = tuning.circle_case(RATE, np.array([0.0, 0.0, -0.01]), 0.02, 0.04, (0.0, 0.0, 360.0))
    response = tuning.respond(RIG, case, RATE, "feedforward", BALL)
    rms, largest = response.error(case.settled)
    assert rms < 10e-6
    assert largest < 30e-6
    assert response.ripple(case.speed, case.settled) < 0.03
    fuzzy = tuning.respond(RIG, case, RATE, "fuzzy", BALL)
    assert 0.3e-3 < fuzzy.error(case.settled)[1] < 2e-3


def test_a_tool_that_turns_as_it_goes_keeps_its_speed_where_legs_reverse() -> None:
    """Once around 36 mm at 12.5 mm/s, tilted by 30 deg inwards, so that the axis turns by 10 deg/s: each leg reverses
    twice, and 0.4 m of lever make much of little. 4 % as a mean over 20 ms and 6 % from tick to tick."""
    tilt, radius, speed = np.radians(30.0), 0.036, 0.0125
    count = round(2.0 * np.pi * radius / speed * RATE)
    angle = np.cumsum(np.minimum(np.arange(count) / (0.2 * RATE), 1.0)) * speed / RATE / radius
    flat = np.column_stack([np.cos(angle), np.sin(angle)])
    tips = np.column_stack([radius * flat, np.full(count, -0.02)])
    axes = np.column_stack([-np.sin(tilt) * flat, np.full(count, np.cos(tilt))])
    legs, force, rest_ticks = legs_of(), np.array([0.0, 0.0, 300.0]), 3000
    found = np.empty((count, 3))
    reversals = 0
    for tick in range(rest_ticks + count):
        share = min(tick / 2500.0, 1.0)
        k = max(tick - rest_ticks, 0)
        before = legs.state.rates.copy()
        tip = share * tips[k] + (1.0 - share) * HERE
        assert legs.move(tip, share * tilt_of(axes[k]), share * force, tick) == 0
        if tick >= rest_ticks:
            found[k] = legs.tip()
            reversals += int((before * legs.state.rates < 0.0).sum())
    way = np.linalg.norm(np.diff(found, axis=0), axis=1)[round(0.5 * RATE) :] * RATE / speed
    assert reversals >= 12
    assert np.abs(np.convolve(way, np.full(10, 0.1), "valid") - 1.0).max() < 0.04
    assert np.abs(way - 1.0).max() < 0.06


def test_the_published_gains_swing_with_these_valves() -> None:
    rig = rig_with(fuzzy={"error_gain": 10.0, "rate_gain": 0.1})
    case = tuning.ramp_case(RATE, HERE, 5e-3)
    found = tuning.respond(rig, case, RATE, "fuzzy", BALL)
    assert found.error()[1] > 0.3e-3


def test_legs_that_the_watch_stops_at_rest_have_a_response_of_one_tick() -> None:
    """A load beyond what the cylinders hold: 400 kN."""
    case = tuning.circle_case(RATE, HERE, 0.02, 0.04, (0.0, 0.0, 4e5))
    stopped = tuning.respond(RIG, case, RATE, "feedforward", BALL)
    assert stopped.found
    assert len(stopped.wanted) < 500  # ticks; it rests for 1 s before the circle begins
    assert np.isnan(stopped.ripple(case.speed, case.settled))


@pytest.mark.parametrize("number", [21, 24, 27])
def test_it_follows_in_other_machines_too(number: int) -> None:
    """Valves 40 % slower to 30 % faster than the controller believes."""
    legs = legs_of(variant=make_variant(number))
    assert rest(legs, 500) == 0
    case = tuning.circle_case(RATE, HERE - [0.02, 0.0, 0.0], 0.02, 0.04)
    largest = 0.0
    for tick, tip in enumerate(case.tips, start=500):
        assert legs.move(tip, UPRIGHT, FREE, tick) == 0
        largest = max(largest, float(np.abs(legs.state.motion[:, 0] - legs.state.wanted).max()))
    assert largest < 50e-6


def test_forces_deflect_the_tip_and_the_transducers_do_not_see_it() -> None:
    """Sum of tau^2 c / F^2 over the legs, from the printed forces for 6.5 kN (Torrao 2013, eq. 8.1) in x."""
    exact = rig_with(encoder={"noise": 0.0, "resolution": 0.0}, cables=None)
    legs = legs_of(exact)
    assert rest(legs, 1500) == 0
    before = legs.tip()
    assert rest(legs, 1500, np.array([500.0, 0.0, 0.0]), 1500) == 0
    moved = legs.tip() - before
    pushes = RIG.hexapod.kinematics().leg_forces(np.array([500.0, 0.0, 0.0]), HERE, np.zeros(2))
    assert legs.state.pushes == pytest.approx(pushes, abs=0.5)
    assert moved[0] == pytest.approx(12.5e-9 * (pushes**2).sum() / 500.0, rel=0.03)
    assert moved[0] > 30e-6
    turned, measured = np.empty((3, 3)), np.empty(3)
    lg.turn(legs.state.measured, turned)
    lg.tip_at(legs.state.measured, turned, legs.constants.platform, measured)
    assert measured == pytest.approx(HERE, abs=2e-6)


def test_errors_of_a_leg_are_errors_of_the_tip() -> None:
    errors = (50e-6, 0.0, 0.0, 0.0, 0.0, 0.0)
    exact = rig_with(encoder={"noise": 0.0, "resolution": 0.0}, cylinder={"errors": errors})
    legs = legs_of(exact)
    hexapod = RIG.hexapod.kinematics()
    rows = hexapod.pose_jacobian(hexapod.place_of(HERE, np.zeros(2)), np.zeros(3))
    step = np.linalg.solve(rows, np.array(errors))
    tip = hexapod.tip_of(hexapod.place_of(HERE, np.zeros(2)) + step[:3], step[3:5])
    assert legs.tip() == pytest.approx(tip, abs=1e-6)  # the step is linear
    assert np.linalg.norm(legs.tip() - HERE) > 30e-6


def test_the_same_again_and_from_a_saved_state() -> None:
    first, second = legs_of(), legs_of()
    assert rest(first, 60) == rest(second, 30) == 0
    saved = copy.deepcopy(second.state)
    third = legs_of()
    third.take_up(saved, 30)
    assert rest(third, 30, start=30) == 0
    for mine, theirs in zip(first.state, third.state, strict=True):
        np.testing.assert_array_equal(mine, theirs)


FAULTS = {
    "valve_stuck": lg.FOLLOWING,
    "encoder_range": lg.ENCODER,
    "encoder_stuck": lg.FOLLOWING,
    "encoder_offset": lg.DISAGREE,
    "pump_stop": lg.LOW_PRESSURE,
    "power_loss": lg.NO_POWER,
    "emergency_stop": lg.EMERGENCY,
}


@pytest.mark.parametrize(("kind", "expected"), FAULTS.items())
def test_faults_stop_the_legs(kind: str, expected: int) -> None:
    """On a moving tip: the watch finds it, the platform stays near, and what is mended goes on from there."""
    leg = 3 if kind in OF_ONE_LEG else None
    fault = LegFault(kind=kind, leg=leg, after=0.2, value=0.9e-3 if kind == "encoder_offset" else 0.0)  # type: ignore[arg-type]
    legs = legs_of(rig_with(faults=(fault,), cables={"limit": 1e-3, "noise": 5e-5}))
    found = tick = 0
    while not found and tick < 1500:
        found = legs.move(HERE - [0.0, 0.0, 4e-5 * min(tick, 150)], UPRIGHT, FREE, tick)
        tick += 1
    assert found == expected
    assert tick > 100
    assert not legs.driven
    told = legs.values()
    assert told["encoders"] == ("L3 out of range" if kind == "encoder_range" else "ok")
    false_pose = kind in ("encoder_offset", "encoder_stuck")  # a leg that stands by its transducer is driven on
    assert told["cables"] == ("disagree" if false_pose else "ok")
    stopped = legs.tip()
    assert abs(stopped[2] - HERE[2] + 4e-5 * min(tick, 150)) < 5e-3
    for later in range(tick, tick + 500):
        legs.move(HERE, UPRIGHT, FREE, later)
    drop = stopped - legs.tip()
    if kind == "power_loss":  # down, and beside the middle of the machine also sideways
        assert 1e-3 < drop[2] < 50e-3
        assert np.hypot(drop[0], drop[1]) < drop[2]
    elif kind not in ("valve_stuck", "encoder_stuck"):  # shut in
        assert np.linalg.norm(drop) < 1e-3
    if kind in ("pump_stop", "power_loss", "emergency_stop"):
        legs.restart()
        start = legs.tip()
        target = legs.state.measured[:3] - legs.constants.platform.sheet
        target[2] -= legs.constants.platform.tool_length + BALL
        for later in range(tick + 500, tick + 800):
            assert legs.move(target, UPRIGHT, FREE, later) == 0
        assert legs.tip() == pytest.approx(start, abs=2e-3)  # caught while it sinks
