"""The upper tool on legs among the axes of the machine: what the legs did is what sheet and encoders see."""

from __future__ import annotations

import numpy as np
from isf_core.errors import ErrorCode
from isf_core.types import Array

from isf_sim.jit import kernel
from isf_sim.legs import legs as lg
from isf_sim.legs.controllers import FULL_VOLTAGE
from isf_sim.legs.hydraulics import PRESSURE, TEMPERATURE
from isf_sim.legs.platform import Platform, tip_at, turn
from isf_sim.machine.axes import AxisErrors, ServoConstants, follow_targets, true_tips
from isf_sim.machine.tick import Axes

Finding = tuple[ErrorCode, str]


def drive_axes(
    legs: lg.Legs, target: Array, tilt: Array, axes: Axes, servo: ServoConstants, errors: AxisErrors, tick: int
) -> int:
    """One tick of the legs and, by its servo, of the lower tool towards ``target`` (6,) m, the upper with ``tilt``
    (2,) rad; the tick's servo is done.

    The encoders tell the pose that the transducers of the legs have, the tip is the true one. Returns bits of what the
    watch of the legs found.
    """
    found = legs.move(target[:3], tilt, axes.force_1, tick)
    state = legs.state
    _take_over(
        target, axes, servo, errors, legs.constants.platform, state.pose, state.measured, state.speed, state.volts
    )
    return found


@kernel
def _take_over(
    target: Array,
    axes: Axes,
    servo: ServoConstants,
    errors: AxisErrors,
    platform: Platform,
    pose: Array,
    measured: Array,
    speed: Array,
    volts: Array,
) -> None:
    axes.saturated[0] = follow_targets(axes.state[3:], axes.target[3:], target[3:], servo) << 3
    for k in range(6):
        if abs(volts[k]) >= FULL_VOLTAGE:
            axes.saturated[0] |= 1
    turned, tip, encoder = np.empty((3, 3)), np.empty(3), np.empty(6)
    turn(measured, turned)
    tip_at(measured, turned, platform, tip)
    for k in range(3):
        axes.state[k, 0], axes.state[k, 1], axes.state[k, 2] = tip[k], speed[k], 0.0
    turn(pose, turned)
    tip_at(pose, turned, platform, tip)
    for k in range(3):
        encoder[k], encoder[3 + k] = tip[k], axes.state[3 + k, 0]
    true_tips(encoder, axes.play, errors, axes.tips)
    axes.target[:] = target
    axes.moved[0] = 1


def leg_faults(found: int, legs: lg.Legs) -> list[Finding]:
    """Codes and texts for bits of the watch."""
    state, limits = legs.state, legs.constants
    leg = int(state.worst[0])
    faults: list[Finding] = []
    if found & lg.EMERGENCY:
        faults.append((ErrorCode.STOP_REQUESTED, "the emergency stop was pressed: pump off, cylinders shut"))
    if found & lg.NO_POWER:
        faults.append((ErrorCode.POWER_LOST, "pump and valves have no power: the platform sinks"))
    if found & lg.ENCODER:
        stroke = 1e3 * limits.platform.stroke
        text = f"the transducer of leg {leg + 1} reads a stroke outside 0 to {stroke:.0f} mm: pump off, cylinders shut"
        faults.append((ErrorCode.ENCODER_RANGE, text))
    if found & lg.FOLLOWING:
        off = 1e3 * abs(state.readings[leg] - state.wanted[leg])
        text = f"leg {leg + 1} is {off:.2f} mm off its set-point, {1e3 * limits.following:g} mm allowed: pump off"
        faults.append((ErrorCode.LEG_NOT_FOLLOWING, text))
    if found & lg.LOW_PRESSURE:
        text = (
            f"the supply has {1e-5 * state.supply[PRESSURE]:.0f} bar, {1e-5 * limits.lowest:.0f} bar are needed: "
            "cylinders shut"
        )
        faults.append((ErrorCode.SUPPLY_PRESSURE, text))
    if found & lg.HOT:
        text = f"the oil has {state.supply[TEMPERATURE]:.0f} deg C, {limits.hottest:g} deg C allowed: pump off"
        faults.append((ErrorCode.OIL_HOT, text))
    if found & lg.DISAGREE:
        text = f"legs and cables disagree by more than {1e3 * limits.cable_limit:g} mm about the platform: pump off"
        faults.append((ErrorCode.ENCODERS_DISAGREE, text))
    if found & lg.LOST_POSE:
        faults.append((ErrorCode.ENCODERS_DISAGREE, "no pose has the lengths that the transducers read: pump off"))
    return faults
