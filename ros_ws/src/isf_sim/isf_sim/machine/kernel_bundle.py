"""Everything that a tick needs but target and noise as one object: see :mod:`isf_sim.sheet.point_bundle`."""

from __future__ import annotations

from typing import Any

from isf_core.types import Array
from numba import types
from numba.experimental import structref

from isf_sim.jit import kernel
from isf_sim.machine.events import EventBounds, conditions
from isf_sim.machine.load_cells import CellState
from isf_sim.machine.tick import NEEDS_JUDGEMENT, Axes, MachineConstants, TargetLimits, advance_tick, check_target
from isf_sim.sheet.control_points import ControlPoints
from isf_sim.sheet.point_bundle import KeptBundle
from isf_sim.sheet.role import Role
from isf_sim.sheet.sheet_point import DONE, Contact
from isf_sim.sheet.squeeze import Squeeze
from isf_sim.sheet.surface import Surface, TipTrack

REQUEST_BITS = 3
"""Low bits of what a tick returns that are its request; above them stands what goes with it."""
REQUESTS = (1 << REQUEST_BITS) - 1
UNCHECKED = -1
"""Instead of the periods without a target: the target is not looked at."""


class TickParts(KeptBundle):
    """Everything for a tick but target and noise."""

    def advance(
        self,
        target: Array,
        draws: Array,
        waited: int,
        parts: tuple[
            Axes,
            Surface,
            TipTrack,
            ControlPoints,
            Contact,
            Squeeze,
            Role,
            CellState,
            CellState,
            MachineConstants,
            TargetLimits,
            EventBounds,
        ],
    ) -> tuple[int, int]:
        """Check ``target`` (6,) m (see :func:`isf_sim.machine.tick.check_target`, or UNCHECKED) and go on with
        :func:`isf_sim.machine.tick.advance_tick`.

        Returns what is asked for and, with NEEDS_JUDGEMENT, what is wrong with the target, with DONE the conditions of
        events (:func:`isf_sim.machine.events.conditions`).
        """
        answer = _advance_tick(target, draws, waited, self.of(parts, _bundle_tick))
        return answer & REQUESTS, answer >> REQUEST_BITS


@structref.register
class _TickType(types.StructRef):
    """numba's type of a bundle for a tick."""


class _TickBundle(structref.StructRefProxy):
    """The bundle as the interpreter sees it."""


structref.define_proxy(
    _TickBundle,
    _TickType,
    [
        "axes",
        "surface",
        "track",
        "points",
        "contact",
        "squeeze",
        "role",
        "cell_1",
        "cell_2",
        "constants",
        "targets",
        "events",
    ],
)


@kernel
def _bundle_tick(
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
    targets: TargetLimits,
    events: EventBounds,
) -> Any:
    return _TickBundle(axes, surface, track, points, contact, squeeze, role, cell_1, cell_2, constants, targets, events)


@kernel
def _advance_tick(target: Array, draws: Array, waited: int, of: Any) -> int:
    axes, surface, contact, squeeze, constants = of.axes, of.surface, of.contact, of.squeeze, of.constants
    if waited >= 0 and axes.moved[0] == 0:
        wrong = check_target(target, axes.target, waited, of.targets)
        if wrong != 0:
            return NEEDS_JUDGEMENT | wrong << REQUEST_BITS
    cell_1, cell_2, role = of.cell_1, of.cell_2, of.role
    request = advance_tick(
        target, draws, axes, surface, of.track, of.points, contact, squeeze, role, cell_1, cell_2, constants
    )
    if request != DONE:
        return request
    turned = role.pressing[0] == 2
    found = conditions(turned, constants.point.radius, axes, surface, contact, squeeze, cell_1, cell_2, of.events)
    return found << REQUEST_BITS
