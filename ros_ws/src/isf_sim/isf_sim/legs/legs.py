"""The six legs of a hexapod in the simulated machine: from targets of the tip to its true and its measured pose.

Each tick: strokes of the target, linear in between; per period of the position loops the transducers are read and the
valves get their voltages; oil, pistons and platform follow in steps of 0.1 ms; the true pose is the one that has the
lengths of the legs with the deflection by the forces along them, the measured one has those that the transducers tell.
Contact with the sheet happens at the true tip. A watch stops pump and valves for what it cannot go on with.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.files.hydraulic_legs import LegFault
from isf_core.files.rig import Rig
from isf_core.geometry.kinematics import UPRIGHT
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.legs.controllers import FULL_VOLTAGE, Loop, loop_of, voltage
from isf_sim.legs.hydraulics import (
    PRESSURE,
    STEP,
    TEMPERATURE,
    Hydraulics,
    balanced_pressures,
    hydraulics_of,
    step_oil,
    warm_oil,
)
from isf_sim.legs.platform import (
    GRAVITY,
    Platform,
    find_pose,
    legs_of,
    place_for,
    platform_of,
    pushes_against,
    seen_by_legs,
    strokes_for,
    tip_at,
    tip_wrench,
    turn,
)
from isf_sim.variant import Variant

BLOCK = 4096
"""Ticks for which noise is drawn at a time."""
FOLLOWING_TIME = 0.02
"""s, for which the following error must be too large."""
SPEED_FILTER = 0.05
"""s, of the speed of the measured tip."""
ENCODER_MARGIN = 1.0e-4
"""m beyond its stroke that a transducer may read."""

FOLLOWING, ENCODER, LOW_PRESSURE, HOT, DISAGREE, LOST_POSE, NO_POWER, EMERGENCY = (1 << k for k in range(8))
"""Bits of what the watch finds."""
PUMP, POWER, DRIVEN = 0, 1, 2
"""Of the switches: pump runs, valves have power, position loops work."""
SQUARES, COUNT, LARGEST, LOWEST = 0, 1, 2, 3
"""Of the tally: sum of squares m^2 and number of the errors of legs while the tool touches the sheet, the largest m;
lowest pressure Pa."""
TOUCHING = 1.0
"""N on the tool, from which on it touches the sheet."""


class LegConstants(NamedTuple):
    """Everything that does not change.

    Attributes
    ----------
    platform, hydraulics, loop ; lead : of the velocities, in ticks
    periods : of the loops per tick ; steps : of the oil per period ; step, tick : s
    compliance : m/N along a leg ; errors : (6,) m ; resolution, noise : m of a transducer
    following : m ; patience : ticks of following error, low pressure, disagreement ; lowest : Pa ; hottest : deg C
    cables : bool ; cable_starts : (3, 2) m ; cable_noise, cable_limit : m
    """

    platform: Platform
    hydraulics: Hydraulics
    loop: Loop
    lead: float
    periods: int
    steps: int
    step: float
    tick: float
    compliance: float
    errors: Array
    resolution: float
    noise: float
    following: float
    patience: NDArray[np.int64]
    lowest: float
    hottest: float
    cables: bool
    cable_starts: Array
    cable_noise: float
    cable_limit: float


class LegState(NamedTuple):
    """Everything that changes.

    Attributes
    ----------
    wanted : (6,) m, strokes of the last target ; rates : (6,) m/s, theirs
    motion : (6, 2) m and m/s, true ; readings : (6,) m by the transducers
    pose, measured : (6,) true and measured ; speed : (3,) m/s of the measured tip ; pushes : (6,) N, of the tip's force
    spools : (6, 2) ; pressures : (6, 2) Pa ; supply : (2,) Pa, deg C ; loops : (6, 3) ; volts : (6,)
    switches : (3,) ; stuck : (6,) valves ; frozen : (6,) transducers ; offsets : (6,) m of transducers
    overdue : (3,) ticks of following error, low pressure, disagreement ; worst : (1,) leg, 0 to 5 ; tally : (4,)
    """

    wanted: Array
    rates: Array
    motion: Array
    readings: Array
    pose: Array
    measured: Array
    speed: Array
    pushes: Array
    spools: Array
    pressures: Array
    supply: Array
    loops: Array
    volts: Array
    switches: NDArray[np.bool_]
    stuck: NDArray[np.bool_]
    frozen: NDArray[np.bool_]
    offsets: Array
    overdue: NDArray[np.int64]
    worst: NDArray[np.int64]
    tally: Array


class Legs:
    """The legs of the upper tool of ``rig``, parked upright with the tip at (3,) m.

    Deterministic for (rig, variant, seeds).

    ``rate``: Hz of the ticks ; ``ball``: m, radius of the tool's ball

    Attributes
    ----------
    state : LegState ; constants : LegConstants
    """

    def __init__(
        self, rig: Rig, variant: Variant, rate: float, tip: Array, ball: float, seeds: tuple[int, ...]
    ) -> None:
        legs = rig.legs
        assert legs is not None  # the rig has them
        self._legs, self._rate, self._seeds = legs, rate, seeds
        hexapod = rig.hexapod.kinematics()
        self._names = hexapod.axes
        platform = platform_of(
            hexapod,
            ball,
            mass=legs.platform_mass,
            gyration=legs.platform_gyration,
            spindle=rig.tool_1.weight / GRAVITY,
            rod=legs.cylinder.rod_mass,
        )
        hydraulics = hydraulics_of(legs, hexapod.stroke, speed=variant.servo_bandwidth, damping=variant.servo_damping)
        periods = max(1, round(rig.servo.rate / rate))
        period = 1.0 / (periods * rate)
        steps = math.ceil(period / STEP - 1e-9)
        supply, cables = legs.supply, legs.cables
        ticks = [FOLLOWING_TIME, supply.patience, cables.patience if cables else 0.0]
        starts = np.zeros((3, 2))
        if cables:
            starts = np.array([[0.0, 0.0], [0.0, cables.c], [cables.a, cables.b]]) + np.array(cables.origin)
        self.constants = LegConstants(
            platform=platform,
            hydraulics=hydraulics,
            loop=loop_of(legs, hydraulics, period),
            lead=legs.feedforward.lead * rate,
            periods=periods,
            steps=steps,
            step=period / steps,
            tick=1.0 / rate,
            compliance=legs.cylinder.compliance * variant.compliance,
            errors=np.array(legs.cylinder.errors),
            resolution=legs.encoder.resolution,
            noise=legs.encoder.noise,
            following=(legs.fuzzy if legs.controller == "fuzzy" else legs.feedforward).following_error,
            patience=np.array([max(1, round(time * rate)) for time in ticks], dtype=np.int64),
            lowest=supply.lowest_pressure,
            hottest=supply.hottest,
            cables=cables is not None,
            cable_starts=starts,
            cable_noise=cables.noise if cables else 0.0,
            cable_limit=cables.limit if cables else 0.0,
        )
        self._due = sorted(legs.faults, key=lambda fault: fault.after)
        self._block, self._noise = -1, np.empty((0, 0))
        self.state = _parked(tip, self.constants, supply.ambient)

    def reaches(self, tip: Array, tilt: Array = UPRIGHT) -> bool:
        """True when legs and joints allow the tip (3,) m with the tilt (2,) rad."""
        return bool(strokes_for(tip, tilt, self.constants.platform, np.empty(6)))

    def move(self, target: Array, tilt: Array, force: Array, tick: int) -> int:
        """Tick number ``tick`` towards the tip (3,) m with the tilt (2,) rad, under ``force`` (3,) N of the sheet on
        the tip; returns bits of what the watch found, which has then stopped pump and valves."""
        found = 0
        while self._due and tick >= self._due[0].after * self._rate:
            found |= self._happen(self._due.pop(0))
        return found | int(move_legs(target, tilt, force, self._draws(tick), self.state, self.constants))

    @property
    def driven(self) -> bool:
        """False once a watch has stopped the legs."""
        return bool(self.state.switches[DRIVEN])

    def take_up(self, state: LegState, tick: int) -> None:
        """Go on from ``state`` with tick number ``tick``."""
        self.state = state
        self._due = sorted(
            (fault for fault in self._legs.faults if fault.after * self._rate > tick - 1), key=lambda item: item.after
        )

    def tip(self) -> Array:
        """(3,) m, the true tip."""
        turned, tip = np.empty((3, 3)), np.empty(3)
        turn(self.state.pose, turned)
        tip_at(self.state.pose, turned, self.constants.platform, tip)
        return tip

    @property
    def names(self) -> tuple[str, ...]:
        """Of the legs."""
        return self._names

    def motion(self) -> tuple[Array, Array, Array]:
        """(6,) m strokes by the transducers, (6,) m/s speeds, (6,) N with which the oil pushes the rods out."""
        state = self.state
        return state.readings, state.motion[:, 1], state.pressures @ (self.constants.hydraulics.areas * [1.0, -1.0])

    def values(self) -> dict[str, object]:
        """State of the hydraulics for people: controller, pressure, oil, transducers."""
        pressure, temperature = self.state.supply.tolist()
        legs, constants = self._legs, self.constants
        strokes = self.state.motion[:, 0] + self.state.offsets
        within = (strokes >= -ENCODER_MARGIN) & (strokes <= constants.platform.stroke + ENCODER_MARGIN)
        beyond = ", ".join(name for name, ok in zip(self.names, within, strict=True) if not ok)
        cables = {"cables": "disagree" if self.state.overdue[2] else "ok"} if constants.cables else {}
        return {
            "leg_controller": legs.controller,
            "supply_bar": round(1e-5 * pressure, 1),
            "oil_deg_c": round(temperature, 1),
            "oil": "warm" if temperature > legs.supply.warm else "ok",
            "pump": "on" if self.state.switches[PUMP] else "off",
            "encoders": f"{beyond} out of range" if beyond else "ok",
            **cables,
        }

    def following(self) -> tuple[float, float]:
        """m, root mean square and largest error of a leg, of all ticks in which the tool touched the sheet."""
        squares, count, largest, _ = self.state.tally.tolist()
        return math.sqrt(squares / count) if count else 0.0, largest

    def restart(self) -> None:
        """After a stop: the pump runs, and the loops hold where the legs are; not for what is broken."""
        state = self.state
        state.switches[:] = True
        state.wanted[:], state.rates[:], state.loops[:], state.overdue[:] = state.readings, 0.0, 0.0, 0
        state.supply[PRESSURE] = self.constants.hydraulics.relief

    def _happen(self, fault: LegFault) -> int:
        state, leg = self.state, (fault.leg or 1) - 1
        if fault.kind == "valve_stuck":
            state.stuck[leg] = True
        elif fault.kind == "encoder_range":
            state.offsets[leg] = -1.0
        elif fault.kind == "encoder_stuck":
            state.frozen[leg] = True
        elif fault.kind == "encoder_offset":
            state.offsets[leg] += fault.value
        else:
            state.switches[PUMP] = False
            if fault.kind == "power_loss":
                state.switches[POWER] = state.switches[DRIVEN] = False
                return NO_POWER
            if fault.kind == "emergency_stop":
                state.switches[DRIVEN] = False
                return EMERGENCY
        return 0

    def _draws(self, tick: int) -> Array:
        block, row = divmod(tick, BLOCK)
        if block != self._block:
            generator = np.random.default_rng([*self._seeds, block])
            self._noise = generator.standard_normal((BLOCK, 6 * self.constants.periods + 3))
            self._block = block
        return np.asarray(self._noise[row])


def _parked(tip: Array, c: LegConstants, temperature: float) -> LegState:
    """At rest under the weights, without play between transducers and lengths."""
    wanted, pose = np.empty(6), np.empty(6)
    strokes_for(tip, UPRIGHT, c.platform, wanted)
    place_for(tip, UPRIGHT, c.platform, pose)
    state = LegState(
        wanted=wanted,
        rates=np.zeros(6),
        motion=np.column_stack([wanted, np.zeros(6)]),
        readings=wanted.copy(),
        pose=pose.copy(),
        measured=pose.copy(),
        speed=np.zeros(3),
        pushes=np.zeros(6),
        spools=np.zeros((6, 2)),
        pressures=np.zeros((6, 2)),
        supply=np.array([c.hydraulics.relief, temperature]),
        loops=np.zeros((6, 3)),
        volts=np.zeros(6),
        switches=np.ones(3, dtype=np.bool_),
        stuck=np.zeros(6, dtype=np.bool_),
        frozen=np.zeros(6, dtype=np.bool_),
        offsets=np.zeros(6),
        overdue=np.zeros(3, dtype=np.int64),
        worst=np.zeros(1, dtype=np.int64),
        tally=np.array([0.0, 0.0, 0.0, c.hydraulics.relief]),
    )
    turned, rates, lengths = np.empty((3, 3)), np.empty((6, 6)), np.empty(6)
    find_pose(c.platform.shortest + wanted + c.errors, c.platform, state.pose)
    legs_of(state.pose, c.platform, turned, rates, lengths)
    mobility, free, pull = np.empty((6, 6)), np.empty(6), np.empty(6)
    seen_by_legs(turned, rates, np.zeros(6), c.platform, mobility, free, pull)
    for k, push in enumerate(-np.linalg.solve(mobility, free) - pull):
        balanced_pressures(push, c.hydraulics, state.pressures[k])
    return state


@kernel
def read_legs(draws: Array, state: LegState, c: LegConstants) -> int:
    """Read the transducers for the next voltages and the measured pose; ENCODER where one is beyond its range."""
    found = 0
    for k in range(6):
        if state.frozen[k]:
            continue
        reading = state.motion[k, 0] + state.offsets[k] + c.noise * draws[k]
        if c.resolution > 0.0:
            reading = c.resolution * math.floor(reading / c.resolution + 0.5)
        if not -ENCODER_MARGIN <= reading <= c.platform.stroke + ENCODER_MARGIN:
            state.worst[0] = k
            found = ENCODER
            continue
        state.readings[k] = reading
    return found


@kernel
def move_legs(target: Array, tilt: Array, force: Array, draws: Array, state: LegState, c: LegConstants) -> int:
    """One tick; see :meth:`Legs.move`. A target out of reach is not followed."""
    end, rates = np.empty(6), np.zeros(6)
    if strokes_for(target, tilt, c.platform, end):
        for k in range(6):
            rates[k] = (end[k] - state.wanted[k]) / c.tick
    else:
        end[:] = state.wanted
    turned, jacobian, lengths = np.empty((3, 3)), np.empty((6, 6)), np.empty(6)
    legs_of(state.pose, c.platform, turned, jacobian, lengths)
    wrench, mobility, free, pull = np.empty(6), np.empty((6, 6)), np.empty(6), np.empty(6)
    tip_wrench(force, turned, c.platform, wrench)
    seen_by_legs(turned, jacobian, wrench, c.platform, mobility, free, pull)
    pushes_against(wrench, jacobian, state.pushes)
    commands = np.zeros(6)
    found = 0
    driven = state.switches[DRIVEN] and state.switches[POWER]
    for period in range(c.periods):
        for k in range(6):
            state.volts[k] = 0.0
            if driven:
                wanted = state.wanted[k] + period * c.loop.period * rates[k]
                ahead = rates[k] + c.lead * (rates[k] - state.rates[k])
                state.volts[k] = voltage(wanted, ahead, state.readings[k], c.loop, state.loops[k])
            commands[k] = state.volts[k] / FULL_VOLTAGE
        for _ in range(c.steps):
            step_oil(
                commands,
                state.stuck,
                state.switches[PUMP],
                state.switches[POWER],
                mobility,
                free,
                pull,
                c.step,
                c.hydraulics,
                state.spools,
                state.pressures,
                state.motion,
                state.supply,
            )
        found |= read_legs(draws[6 * period : 6 * period + 6], state, c)
    state.wanted[:], state.rates[:] = end, rates
    warm_oil(state.switches[PUMP], c.tick, c.hydraulics, state.supply)
    found |= _find_poses(draws[6 * c.periods :], state, c)
    if abs(force[0]) + abs(force[1]) + abs(force[2]) > TOUCHING and driven:
        for k in range(6):
            error = abs(state.motion[k, 0] - end[k])
            state.tally[SQUARES] += error * error
            state.tally[COUNT] += 1.0
            state.tally[LARGEST] = max(state.tally[LARGEST], error)
    state.tally[LOWEST] = min(state.tally[LOWEST], state.supply[PRESSURE])
    found |= _watch(end, state, c)
    if found != 0:
        state.switches[PUMP] = state.switches[DRIVEN] = False
    return found


@kernel
def _find_poses(draws: Array, state: LegState, c: LegConstants) -> int:
    """True pose from the lengths under load, measured pose from the readings, and what the cables say of it."""
    platform, found = c.platform, 0
    lengths, turned, before, tip = np.empty(6), np.empty((3, 3)), np.empty(3), np.empty(3)
    for k in range(6):
        lengths[k] = platform.shortest + state.motion[k, 0] + c.errors[k] - c.compliance * state.pushes[k]
    pose = state.pose.copy()
    if find_pose(lengths, platform, pose) < 0:
        return LOST_POSE
    state.pose[:] = pose
    turn(state.measured, turned)
    tip_at(state.measured, turned, platform, before)
    for k in range(6):
        lengths[k] = platform.shortest + state.readings[k]
    pose[:] = state.measured
    if find_pose(lengths, platform, pose) < 0:
        found |= LOST_POSE
    else:
        state.measured[:] = pose
    turn(state.measured, turned)
    tip_at(state.measured, turned, platform, tip)
    share = min(c.tick / SPEED_FILTER, 1.0)
    for k in range(3):
        state.speed[k] += share * ((tip[k] - before[k]) / c.tick - state.speed[k])
    if c.cables:
        state.overdue[2] = state.overdue[2] + 1 if _disagreement(draws, state, c) > c.cable_limit else 0
        if state.overdue[2] >= c.patience[2]:
            found |= DISAGREE
    return found


@kernel
def _disagreement(draws: Array, state: LegState, c: LegConstants) -> float:
    """m, between the platform by the transducers and by the cables (Torrao 2013, 4.3.3, corrected)."""
    squares, starts = np.empty(3), c.cable_starts
    for k in range(3):
        dx, dy, dz = state.pose[0] - starts[k, 0], state.pose[1] - starts[k, 1], state.pose[2]
        squares[k] = (math.sqrt(dx * dx + dy * dy + dz * dz) + c.cable_noise * draws[k]) ** 2
    length = starts[1, 1] - starts[0, 1]
    a, b = starts[2, 0] - starts[0, 0], starts[2, 1] - starts[0, 1]
    y = (length**2 + squares[0] - squares[1]) / (2.0 * length)
    x = (a**2 + b**2 + squares[0] - squares[2] - 2.0 * b * y) / (2.0 * a)
    z = -math.sqrt(max(squares[0] - x * x - y * y, 0.0))
    x, y = x + starts[0, 0] - state.measured[0], y + starts[0, 1] - state.measured[1]
    z -= state.measured[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel
def _watch(wanted: Array, state: LegState, c: LegConstants) -> int:
    """Bits for following errors, pressure and temperature."""
    if not state.switches[DRIVEN]:
        return 0
    largest, found = 0.0, 0
    for k in range(6):
        error = abs(state.readings[k] - wanted[k])
        if error > largest:
            largest = error
            if error > c.following:
                state.worst[0] = k
    state.overdue[0] = state.overdue[0] + 1 if largest > c.following else 0
    state.overdue[1] = state.overdue[1] + 1 if state.supply[PRESSURE] < c.lowest else 0
    if state.overdue[0] >= c.patience[0]:  # legs without pressure do not follow either
        found |= LOW_PRESSURE if state.supply[PRESSURE] < c.lowest else FOLLOWING
    if state.overdue[1] >= c.patience[1]:
        found |= LOW_PRESSURE
    if state.supply[TEMPERATURE] > c.hottest:
        found |= HOT
    return found
