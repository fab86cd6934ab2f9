"""One control tick of the machine as a single compiled kernel: servo, sheet, squeeze, load cells, limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.machine.axes import AxisErrors, ServoConstants, follow_targets, true_tips
from isf_sim.machine.load_cells import CellConstants, CellState, read_cell
from isf_sim.sheet.adsif import Adsif, AdsifConstants, form_ring
from isf_sim.sheet.control_points import ControlPoints
from isf_sim.sheet.role import NEEDS_TURN, Role, other_tool_presses
from isf_sim.sheet.sheet_point import DONE, Contact, PointConstants, advance_point
from isf_sim.sheet.squeeze import Squeeze, SqueezeConstants, eased_tension, squeeze_sheet
from isf_sim.sheet.surface import Surface, TipTrack
from isf_sim.sheet.turned_sheet import turn_tip

NEEDS_JUDGEMENT = 5
"""Asked for by a tick whose target is not as it should be; see sheet_point.DONE."""

FORCE_EXCEEDED, TOOLS_TOUCH = 1, 2
"""Bits of Axes.flags."""


class MachineConstants(NamedTuple):
    """Constants of every part the kernels need."""

    servo: ServoConstants
    errors: AxisErrors
    point: PointConstants
    squeeze: SqueezeConstants
    cell_1: CellConstants
    cell_2: CellConstants
    force_limit: Array


class Axes(NamedTuple):
    """Both tools' axes.

    Attributes
    ----------
    state : (6, 3) encoder position m, speed, acceleration of x, y, z of tool 1, then of tool 2
    target : (6,) m held at the last tick ; play : (6,) m, driven side of the backlash ; tips : (2, 3) m, true tips
    moved : (1,) 1 when the servo has done the present tick already
    force_1, force_2 : (3,) N, true force of the sheet on each tool ; flags : (1,) ; saturated : (1,) a bit per axis
    """

    state: Array
    target: Array
    play: Array
    tips: Array
    moved: NDArray[np.int64]
    force_1: Array
    force_2: Array
    flags: NDArray[np.int64]
    saturated: NDArray[np.int64]


def parked_axes(tip_1: Array, tip_2: Array, errors: AxisErrors) -> Axes:
    """At rest with the tips at (3,), (3,) m by the encoders."""
    target = np.concatenate([tip_1, tip_2])
    state = np.zeros((6, 3))
    state[:, 0] = target
    play, tips = target.copy(), target.reshape(2, 3).copy()
    true_tips(target, play, errors, tips)
    return Axes(
        state=state,
        target=target,
        play=play,
        tips=tips,
        moved=np.zeros(1, dtype=np.int64),
        force_1=np.zeros(3),
        force_2=np.zeros(3),
        flags=np.zeros(1, dtype=np.int64),
        saturated=np.zeros(1, dtype=np.int64),
    )


@kernel
def advance_tick(
    target: Array,
    draws: Array,
    axes: Axes,
    surface: Surface,
    track: TipTrack,
    points: ControlPoints,
    contact: Contact,
    squeeze: Squeeze,
    role: Role,
    cell_1: CellState,
    cell_2: CellState,
    constants: MachineConstants,
) -> int:
    """Advance one tick towards ``target`` (6,) m with the normal numbers ``draws`` (18,).

    ``constants`` are those of the tool that presses. Returns DONE, or what the sheet needs first; the caller serves
    the request and calls again.
    """
    move_axes(target, axes, constants)
    forming, support = np.empty(3), np.empty(3)
    turned = role.pressing[0] == 2
    if turned:
        turn_tip(axes.tips[1], constants.squeeze.thickness, forming)
        turn_tip(axes.tips[0], constants.squeeze.thickness, support)
    else:
        forming[:] = axes.tips[0]
        support[:] = axes.tips[1]
    if constants.squeeze.present and other_tool_presses(
        forming, support, constants.point.step, surface, contact, role, constants.squeeze
    ):
        return NEEDS_TURN
    pull = np.empty(2)
    pull[0], pull[1] = -squeeze.force[0], -squeeze.force[1]
    # of the last tick, so that forming force and squeeze need not be solved for together
    eased = eased_tension(squeeze, contact, constants.squeeze)
    request = advance_point(forming, pull, eased, surface, track, points, contact, constants.point)
    if request != DONE:
        return request
    squeeze_sheet(forming, support, surface, contact, squeeze, constants.squeeze)
    for k in range(3):
        on_forming, on_support = -contact.force[k] - squeeze.force[k], squeeze.force[k]
        if turned:
            sign = -1.0 if k == 2 else 1.0
            axes.force_1[k], axes.force_2[k] = sign * on_support, sign * on_forming
        else:
            axes.force_1[k], axes.force_2[k] = on_forming, on_support
    finish_tick(draws, axes, cell_1, cell_2, constants)
    if squeeze.indentation[0] > 0.0 and squeeze.indentation[0] >= squeeze.thickness[0]:
        axes.flags[0] |= TOOLS_TOUCH
    return DONE


@kernel
def advance_adsif_tick(
    target: Array,
    draws: Array,
    axes: Axes,
    surface: Surface,
    state: Adsif,
    ring: AdsifConstants,
    cell_1: CellState,
    cell_2: CellState,
    constants: MachineConstants,
) -> int:
    """Advance one tick of accumulative forming; returns what the sheet did (adsif.STABLE, BUCKLES, FREE)."""
    move_axes(target, axes, constants)
    outcome = form_ring(axes.tips[0], axes.tips[1], surface, state, ring)
    for k in range(3):
        axes.force_1[k] = -state.force[k]
        axes.force_2[k] = state.force[k]
    finish_tick(draws, axes, cell_1, cell_2, constants)
    return outcome


@kernel
def move_axes(target: Array, axes: Axes, constants: MachineConstants) -> None:
    """Servo towards ``target`` once per tick, and the true tips that follow from the encoders' positions."""
    if axes.moved[0] != 0:
        return
    axes.saturated[0] = follow_targets(axes.state, axes.target, target, constants.servo)
    axes.target[:] = target
    axes.moved[0] = 1
    if constants.errors.present:
        true_tips(axes.state[:, 0], axes.play, constants.errors, axes.tips)
    else:
        for k in range(3):
            axes.tips[0, k] = axes.state[k, 0]
            axes.tips[1, k] = axes.state[3 + k, 0]


@kernel
def finish_tick(draws: Array, axes: Axes, cell_1: CellState, cell_2: CellState, constants: MachineConstants) -> None:
    """Limits and readings of a tick whose forces are known."""
    axes.moved[0] = 0
    axes.flags[0] = 0
    for k in range(3):
        if max(abs(axes.force_1[k]), abs(axes.force_2[k])) > constants.force_limit[k]:
            axes.flags[0] |= FORCE_EXCEEDED
    read_cell(axes.force_1, draws[:6], draws[12:15], constants.cell_1, cell_1)
    read_cell(axes.force_2, draws[6:12], draws[15:], constants.cell_2, cell_2)


NOT_FINITE, JUMP, OUTSIDE, OVERLAP, FAST = 1, 2, 4, 8, 16
"""Bits returned by :func:`check_target`."""


class TargetLimits(NamedTuple):
    """What a target may be, all m.

    Attributes
    ----------
    travel : (3,) largest |coordinate| ; jump : largest step ; speed : step at the speed limit (FAST alone is no fault)
    upper, lower : radii of the balls, or of the roundings of flat tips, which may overlap by ``overlap`` (the machine
        gives way by as much) ; flat : sum of the radii of the flats
    """

    travel: Array
    jump: float
    speed: float
    upper: float
    lower: float
    overlap: float
    flat: float


@kernel
def check_target(target: Array, held: Array, waited: int, limits: TargetLimits) -> int:
    """What is wrong with ``target`` (6,) m after ``held`` (6,) m: bits, 0 when nothing is.

    ``waited``: periods without a target before it; the step may be larger by as many.
    """
    jump, speed = limits.jump * (1 + waited), limits.speed * (1 + waited) * (1.0 + 1e-9)
    for k in range(6):
        if not math.isfinite(target[k]):
            return NOT_FINITE
    bits = 0
    for tool in range(2):
        square = 0.0
        for k in range(3):
            square += (target[3 * tool + k] - held[3 * tool + k]) ** 2
            if abs(target[3 * tool + k]) > limits.travel[k]:
                bits |= OUTSIDE
        if square > jump * jump:
            bits |= JUMP
        if square > speed * speed:
            bits |= FAST
    dx, dy = target[3] - target[0], target[4] - target[1]
    dz = (target[5] - limits.lower) - (target[2] + limits.upper)
    if limits.lower > 0.0 and apart(dx, dy, dz, limits.flat) < limits.upper + limits.lower - limits.overlap:
        bits |= OVERLAP
    return bits


@kernel
def apart(dx: float, dy: float, dz: float, flat: float) -> float:
    """m between the flats of two upright tools whose centres are ``dx``, ``dy``, ``dz`` m apart, ``flat`` m the sum of
    their radii; 0: between the centres of two balls."""
    if flat > 0.0:
        beside = max(math.sqrt(dx * dx + dy * dy) - flat, 0.0)
        return math.sqrt(beside * beside + dz * dz)
    return math.sqrt(dx * dx + dy * dy + dz * dz)
