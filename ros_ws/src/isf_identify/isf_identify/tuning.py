"""Tuning sandbox: the force loop around a servo, a contact spring and a noisy load cell, without a sheet.

Along the horizontal normal only (Ren 2018, eq. 2-7 to 2-11 and section 2.3.4)::

    F = K_c (eps - P_s) >= 0,     P_s = G_m(s) (planned - offset)

with a third-order Butterworth servo and noise of 1 % of the force. Three cases tell what a configuration is worth: a
step of the set-point, a corner (the gap opens and closes within 0.1 s) and a ramp of the gap. Beside the integral law
that the controller uses there are the proportional and the proportional-integral law, which the source rejects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from isf_core.types import Array
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_laws import OscillationMonitor
from isf_force_ctrl.laws.force_and_compliance import ContactForceLoop, Fir, group_delay
from isf_force_ctrl.laws.stability import ultimate_loop_gain
from scipy.signal import cont2discrete

Law = Literal["I", "P", "PI"]

START = 100.0
"""N, force at the begin of every case."""


@dataclass(frozen=True)
class Plant:
    """What the loop is tried on: ``stiffness`` N/m, ``delay`` s beyond filter and hold, ``noise`` as a share."""

    stiffness: float
    delay: float = 0.0
    noise: float = 0.01


@dataclass(frozen=True)
class Case:
    """A disturbance: ``set_point`` (N) and ``gap`` (m, opening) as functions of time (s), for ``seconds``."""

    name: str
    set_point: Callable[[float], float]
    gap: Callable[[float], float]
    seconds: float = 1.5


@dataclass(frozen=True)
class Response:
    """(T,) s, (T,) N set-point, (T,) N true force, (T,) m offset; ``backoffs`` of the oscillation monitor."""

    time: Array
    set_point: Array
    force: Array
    offset: Array
    backoffs: int

    def within(self, band: float = 10.0, start: float = 0.1) -> float:
        """Share of the time from ``start`` s on in which the force is within ``band`` N of its set-point."""
        later = self.time >= start
        return float(np.mean(np.abs(self.force - self.set_point)[later] <= band))

    def largest_error(self, start: float = 0.1) -> float:
        """N, from ``start`` s on."""
        return float(np.abs(self.force - self.set_point)[self.time >= start].max())

    def settling(self, at: float = 0.1, band: float = 10.0) -> float:
        """s after ``at`` from which the force stays within ``band`` N of its set-point; infinite when it does not."""
        after = self.time >= at
        outside = np.flatnonzero(np.abs(self.force - self.set_point)[after] > band)
        if not len(outside):
            return 0.0
        if outside[-1] == np.count_nonzero(after) - 1:
            return float("inf")
        return float(self.time[after][outside[-1] + 1] - at)

    def overshoot(self) -> float:
        """N above the last set-point."""
        return float(max(0.0, self.force.max() - self.set_point[-1]))


def step_case(size: float = 100.0) -> Case:
    """The set-point rises by ``size`` N at 0.1 s."""
    return Case("step", lambda t: START + (size if t >= 0.1 else 0.0), lambda t: 0.0)


def corner_case(opening: float = 60e-6, duration: float = 0.1) -> Case:
    """The gap opens by ``opening`` m and closes again within ``duration`` s, as at the corner of a pyramid."""

    def gap(t: float) -> float:
        s = (t - 0.1) / duration
        return opening * 0.5 * (1 - np.cos(2 * np.pi * s)) if 0.0 < s < 1.0 else 0.0

    return Case("corner", lambda t: START, gap)


def ramp_case(rate: float = 300e-6) -> Case:
    """The gap opens with ``rate`` m/s from 0.1 s on: the sheet thins, or the forming tool gives way."""
    return Case("ramp", lambda t: START, lambda t: rate * max(0.0, t - 0.1))


def respond(config: ControlConfig, plant: Plant, case: Case, law: Law = "I", *, p_gain: float = 1.0) -> Response:
    """Closed loop of ``config`` with the law on ``plant``; ``p_gain``: K_p K_c of the laws P and PI."""
    servo = _Servo(config.servo_bandwidth, config.rate)
    loop, monitor = ContactForceLoop(config.contact_force()), OscillationMonitor(config.rate, config.oscillation_swing)
    fir, error_fir = Fir(config.coefficients(), START), Fir(config.coefficients())
    late = [0.0] * (round(plant.delay * config.rate) + 1)
    random = np.random.default_rng(0)
    rows, force = [], START
    for tick in range(int(case.seconds * config.rate)):
        time = tick / config.rate
        wanted = case.set_point(time)
        measured = force * (1.0 + plant.noise * random.standard_normal())
        scale = monitor.step(wanted - fir.step(measured))
        loop.set_gain(scale * config.loop_gain / config.contact_stiffness)
        integral = loop.control(wanted - measured) if law != "P" else 0.0
        proportional = 0.0
        if law != "I":
            proportional = p_gain / config.contact_stiffness * error_fir.step(wanted - measured)
        late.append(integral + proportional)
        offset = late.pop(0)
        force = max(0.0, START + plant.stiffness * (servo.step(offset) - case.gap(time)))
        rows.append((time, wanted, force, offset))
    columns = np.array(rows).T
    return Response(columns[0], columns[1], columns[2], columns[3], monitor.found)


def gain_margin(config: ControlConfig, stiffness: float, delay: float) -> float:
    """Factor by which the gain may grow before the loop oscillates, when the contact has ``stiffness`` (N/m).

    The gain stays that of the configuration. ``delay`` s comes on top of filter and hold. Compliance compensation acts
    at the same time; where K_p K_c reaches 1 the margin is 0.
    """
    coupling = config.compensation * max(config.forming_compliance) * stiffness
    if coupling >= 1.0:
        return 0.0
    own = group_delay(len(config.coefficients()), config.rate) + 1.5 / config.rate
    ultimate = ultimate_loop_gain(config.servo_bandwidth, own + delay, coupling, config.compliance_time)
    return ultimate / (config.loop_gain * stiffness / config.contact_stiffness)


def margin_map(config: ControlConfig, stiffness: Array, delay: Array) -> Array:
    """(D, K) gain margins over ``delay`` (D,) s and ``stiffness`` (K,) N/m."""
    return np.array([[gain_margin(config, float(k), float(d)) for k in stiffness] for d in delay])


class _Servo:
    """Third-order Butterworth axis with a first-order hold of its input."""

    def __init__(self, bandwidth: float, rate: float) -> None:
        corner = 2 * np.pi * bandwidth
        continuous = ([corner**3], [1.0, 2 * corner, 2 * corner**2, corner**3])
        numerator, denominator, _ = cont2discrete(continuous, 1.0 / rate, method="foh")
        self._b: list[float] = np.ravel(numerator).tolist()
        self._a: list[float] = np.ravel(denominator).tolist()[1:]
        self._inputs, self._outputs = [0.0] * len(self._b), [0.0] * len(self._a)

    def step(self, command: float) -> float:
        """Position (m) after one tick."""
        self._inputs = [command, *self._inputs[:-1]]
        position = sum(b * u for b, u in zip(self._b, self._inputs, strict=True))
        position -= sum(a * y for a, y in zip(self._a, self._outputs, strict=True))
        self._outputs = [position, *self._outputs[:-1]]
        return position
