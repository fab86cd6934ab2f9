"""Position loops of the legs, compiled: set-point, its velocity and the transducer's reading to the valve's voltage.

Two controllers behind one function: the fuzzy one of the source, and feedforward of the velocity with a proportional
and integral correction. Each leg has its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from isf_core.files.hydraulic_legs import HydraulicLegs
from isf_core.types import Array

from isf_sim.jit import kernel
from isf_sim.legs.fuzzy import build_table, look_up
from isf_sim.legs.hydraulics import Hydraulics, free_speeds

FULL_VOLTAGE = 10.0
"""V, of the valves and of the converter before them."""
CREEP = 6.0e-5
"""m/s of a leg over which the voltage passes the dead band, so that rest is no step between its ends. A leg slower than
0.4 of it stands still, and where it reverses the tip is kicked by three times that speed: with 0.33 mm/s the speed of a
tilted tool was off by 6 %, with 0.06 mm/s by 2.5 %. Noise of 1.5 um makes as much of the default ``gain``."""
LEARNING = 10.0
"""1/s, how fast the share is learned by which a leg is slower than its valve's nominal curve says, under its load and
friction (2 to 3 % here). Chosen on the simulated legs: a quarter of the default ``gain``; with half as much they are
off by 47 instead of 37 um in contact."""
SLOW = 2e-2
"""m/s, below which speed little is learned of that share: there a dead band counts for more."""
LARGEST_SHARE = 0.2
"""Of both shares, either way; variants have valves that are up to 40 % slower, the integral part does the rest."""
INTEGRAL = 0
"""Of a loop's state: integral part m/s."""
LAST, RATE = 1, 2
"""The same of the fuzzy controller: last error m, filtered rate of the error m/s."""
OUT, BACK = 1, 2
"""The same of the other controller: share by which the leg is slower than nominal outwards and inwards."""


class Loop(NamedTuple):
    """Constants of the position loops.

    Attributes
    ----------
    fuzzy : which of both ; period : s
    table ; error_gain 1/m ; rate_gain s/m ; output_gain V ; filter : share of a new rate
    out, back : m/s of a leg at 10 V ; dead_band : share of 10 V ; gain : 1/s ; integral : 1/s^2
    """

    fuzzy: bool
    period: float
    table: Array
    error_gain: float
    rate_gain: float
    output_gain: float
    filter: float
    out: float
    back: float
    dead_band: float
    gain: float
    integral: float


def loop_of(legs: HydraulicLegs, hydraulics: Hydraulics, period: float) -> Loop:
    """Constants of the controller that ``legs`` names, with ``period`` s; it knows the valves' nominal curves."""
    fuzzy, linear = legs.fuzzy, legs.feedforward
    out, back = free_speeds(hydraulics)
    return Loop(
        fuzzy=legs.controller == "fuzzy",
        period=period,
        table=build_table(),
        error_gain=1e3 * fuzzy.error_gain,
        rate_gain=1e3 * fuzzy.rate_gain,
        output_gain=fuzzy.output_gain,
        filter=period / (period + fuzzy.filter_time),
        out=out,
        back=back,
        dead_band=legs.valve.dead_band,
        gain=linear.gain,
        integral=linear.gain / linear.integral_time,
    )


@kernel
def voltage(wanted: float, velocity: float, measured: float, loop: Loop, state: Array) -> float:
    """V for the valve, within +-10, towards the stroke ``wanted`` m that moves with ``velocity`` m/s.

    ``state`` (3,) of the leg's loop is updated. Positive extends the leg.
    """
    if loop.fuzzy:
        error = measured - wanted
        state[RATE] += loop.filter * ((error - state[LAST]) / loop.period - state[RATE])
        state[LAST] = error
        output = loop.output_gain * look_up(loop.error_gain * error, loop.rate_gain * state[RATE], loop.table)
        return min(max(output, -FULL_VOLTAGE), FULL_VOLTAGE)
    error = wanted - measured
    way = OUT if velocity > 0.0 else BACK
    proportional = (1.0 + state[way]) * velocity + loop.gain * error
    speed = proportional + state[INTEGRAL]
    full = loop.out if speed > 0.0 else loop.back
    share = speed / full
    if abs(share) < 1.0 or share * error < 0.0:  # no winding up at the end of the voltage
        state[INTEGRAL] += loop.integral * loop.period * error
        learned = LEARNING * loop.period * loop.gain * error * velocity / (velocity * velocity + SLOW * SLOW)
        state[way] = min(max(state[way] + learned, -LARGEST_SHARE), LARGEST_SHARE)
    share = min(max(share, -1.0), 1.0)
    lift = loop.dead_band * math.tanh(speed / CREEP)
    return FULL_VOLTAGE * (lift + (1.0 - loop.dead_band) * share)
