"""Pump, valves and cylinders against hand calculation and the numbers of Torrao 2013, 3.6.1 and Table 3.1."""

from __future__ import annotations

import math

import numpy as np
import pytest
from isf_core.files.rig import load_rig
from isf_sim.legs.hydraulics import (
    PRESSURE,
    TEMPERATURE,
    Hydraulics,
    balanced_pressures,
    free_speeds,
    hydraulics_of,
    oil_stiffness,
    opening_of,
    step_oil,
    warm_oil,
)

LEGS = load_rig("torrao2013").legs
assert LEGS is not None
NOMINAL = hydraulics_of(LEGS, 0.4)
IDEAL = NOMINAL._replace(supply_leak=0.0, piston_leak=0.0, coulomb=0.0, viscous=0.0)
MASS = 20.0


class Bench:
    """Six cylinders side by side, a mass on each."""

    def __init__(self, c: Hydraulics, stroke: float = 0.1) -> None:
        self.c = c
        self.spools, self.pressures, self.supply = np.zeros((6, 2)), np.zeros((6, 2)), np.array([c.relief, 25.0])
        self.motion = np.column_stack([np.full(6, stroke), np.zeros(6)])
        for row in self.pressures:
            balanced_pressures(0.0, c, row)

    def run(self, commands: float | np.ndarray, seconds: float, step: float = 1e-4, *, pump: bool = True) -> None:
        commands = np.broadcast_to(commands, 6).astype(float)
        none, zero = np.zeros(6, dtype=np.bool_), np.zeros(6)
        for _ in range(round(seconds / step)):
            step_oil(
                commands, none, pump, True, np.eye(6) / MASS, zero, zero, step, self.c,
                self.spools, self.pressures, self.motion, self.supply,
            )  # fmt: skip


def test_areas_are_those_of_the_source() -> None:
    assert NOMINAL.areas * 1e6 == pytest.approx([3117.2, 1526.8], abs=0.1)


def test_six_legs_share_the_flow_of_the_pump() -> None:
    """112 l/min into six pistons give 99.8 mm/s; a single one reaches what its valve passes."""
    every = Bench(IDEAL)
    every.run(1.0, 0.5)
    assert every.motion[:, 1] * 1e3 == pytest.approx([99.8] * 6, abs=0.2)
    assert every.supply[PRESSURE] < 0.95 * NOMINAL.relief  # the relief valve is shut, all the flow goes to the legs
    one = Bench(IDEAL)
    one.run(np.array([1.0, 0, 0, 0, 0, 0]), 0.3)
    out, back = free_speeds(IDEAL)
    assert one.motion[0, 1] == pytest.approx(out, rel=0.01)
    assert one.motion[1:, 1] == pytest.approx(np.zeros(5), abs=1e-5)
    one.run(np.array([-1.0, 0, 0, 0, 0, 0]), 0.3)
    assert one.motion[0, 1] == pytest.approx(-back, rel=0.02)  # it draws some flow from the relief valve


def test_flow_through_both_edges_by_hand() -> None:
    """12 l/min at 35 bar; outwards: A v = q sqrt(p - p_A), a v = q/2 sqrt(p_B), p_A A = p_B a."""
    large, small = IDEAL.areas
    q = 2e-4 / math.sqrt(35e5)
    out, _ = free_speeds(IDEAL)
    rod_side = (small * out / (0.5 * q)) ** 2
    assert large * out == pytest.approx(q * math.sqrt(160e5 - rod_side * small / large), rel=1e-9)


def test_balance_of_oil() -> None:
    """What the pump delivers with the valves shut goes over the relief valve and through the valves' leakage."""
    bench = Bench(NOMINAL)
    bench.run(0.0, 0.3)
    p = bench.supply[PRESSURE]
    assert 155e5 < p < 160e5
    relieved = (p - 155e5) / 5e5 * 112.0
    assert relieved + 6 * 0.6 * p / 210e5 == pytest.approx(112.0, abs=0.05)  # l/min
    bench.run(0.0, 1.0, pump=False)
    decay = 1.2e9 / 2e-3 * 6 * 1e-5 / 210e5  # 1/s: bulk modulus over volume, times the valves' leakage
    assert bench.supply[PRESSURE] == pytest.approx(p * math.exp(-decay), rel=0.04)  # the relief valve closes first
    assert np.abs(bench.motion[:, 1]).max() < 1e-4  # shut in


def test_a_step_of_the_valve_ends_within_the_published_time() -> None:
    bench = Bench(IDEAL)
    bench.run(0.5, 3.5e-3)
    assert bench.spools[:, 0] == pytest.approx([0.5] * 6, abs=0.05)


def test_dead_band() -> None:
    assert opening_of(0.004, 0.005) == 0.0
    assert opening_of(-1.0, 0.005) == -1.0
    assert opening_of(0.5025, 0.005) == pytest.approx(0.5)


def test_oil_is_a_spring() -> None:
    """By hand, in the middle of the stroke: beta (A^2 / (V0 + A s) + a^2 / (V0 + a s)); and a leg gives way by it."""
    a, b = 3.1172e-3, 1.5268e-3
    expected = 1.2e9 * (a**2 / (1e-4 + 0.2 * a) + b**2 / (1e-4 + 0.2 * b))
    assert oil_stiffness(0.2, NOMINAL) == pytest.approx(expected, rel=1e-3)
    bench = Bench(NOMINAL, 0.2)
    zero, none = np.zeros(6), np.zeros(6, dtype=np.bool_)
    for _ in range(5000):
        step_oil(
            zero, none, True, True, np.eye(6) / MASS, zero, np.full(6, -1000.0), 1e-4,
            NOMINAL._replace(coulomb=0.0, piston_leak=0.0), bench.spools, bench.pressures, bench.motion, bench.supply,
        )  # fmt: skip
    assert 0.2 - bench.motion[:, 0] == pytest.approx([1000.0 / expected] * 6, rel=0.01)


def test_half_the_step_gives_the_same_motion() -> None:
    whole, half = Bench(NOMINAL), Bench(NOMINAL)
    commands = np.array([0.1, -0.1, 0.3, 0.05, 0.0, 0.6])
    whole.run(commands, 0.1)
    half.run(commands, 0.1, 5e-5)
    assert whole.motion[:, 0] == pytest.approx(half.motion[:, 0], abs=1e-5)


def test_oil_warms_as_observed() -> None:
    """Torrao 2013, 3.6.1: 1.374 K/min without cooler, 48.9 deg C in the end with it, time constant 17.4 min."""
    supply = np.array([160e5, 25.0])
    warm_oil(True, 60.0, NOMINAL._replace(heat_loss=0.0), supply)
    assert supply[TEMPERATURE] - 25.0 == pytest.approx(1.374, abs=1e-3)
    supply[TEMPERATURE] = 25.0
    for _ in range(round(17.4 * 60)):
        warm_oil(True, 1.0, NOMINAL, supply)
    assert supply[TEMPERATURE] - 25.0 == pytest.approx((1.0 - math.exp(-1.0)) * 23.9, abs=0.05)
    for _ in range(6 * 3600):
        warm_oil(True, 1.0, NOMINAL, supply)
    assert supply[TEMPERATURE] == pytest.approx(48.9, abs=0.1)
