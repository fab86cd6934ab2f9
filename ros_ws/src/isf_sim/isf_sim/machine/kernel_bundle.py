"""State and constants handed to the kernels of a tick as one object instead of a hundred arrays.

To take an array over from the interpreter costs a compiled function some 0.2 us, and three times that where other work
has emptied the processor's caches since the last tick; for everything that a tick needs this is more than the tick
itself. A bundle takes them over once, and again only when one of them is another object. It holds the arrays
themselves, not copies.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import is_
from typing import Any

from isf_core.types import Array
from numba import types
from numba.experimental import structref

from isf_sim.jit import kernel
from isf_sim.machine.events import EventBounds, conditions
from isf_sim.machine.load_cells import CellState
from isf_sim.machine.tick import NEEDS_JUDGEMENT, Axes, MachineConstants, TargetLimits, advance_tick, check_target
from isf_sim.sheet.control_points import ControlPoints
from isf_sim.sheet.role import Role
from isf_sim.sheet.sheet_point import DONE, Contact, PointConstants, advance_point
from isf_sim.sheet.squeeze import Squeeze
from isf_sim.sheet.surface import Surface, TipTrack

REQUEST_BITS = 3
"""Low bits of what a tick returns that are its request; above them stands what goes with it."""
REQUESTS = (1 << REQUEST_BITS) - 1
UNCHECKED = -1
"""Instead of the periods without a target: the target is not looked at."""


class _Kept:
    """A bundle that is made again when one of its parts is another object; never part of a state."""

    constant_of_state = True

    def __init__(self) -> None:
        self._parts: tuple[Any, ...] = ()
        self._bundle: Any = None

    def _of(self, parts: tuple[Any, ...], make: Callable[..., Any]) -> Any:
        if not (len(parts) == len(self._parts) and all(map(is_, parts, self._parts))):
            self._parts, self._bundle = parts, make(*parts)
        return self._bundle

    def __deepcopy__(self, memo: dict[int, Any]) -> _Kept:
        return type(self)()


class PointParts(_Kept):
    """Surface, track, points, contact and constants for :func:`isf_sim.sheet.sheet_point.advance_point`."""

    def advance(
        self,
        tip: Array,
        pull: Array,
        eased: float,
        parts: tuple[Surface, TipTrack, ControlPoints, Contact, PointConstants],
    ) -> int:
        """:func:`isf_sim.sheet.sheet_point.advance_point` with ``parts``."""
        return int(_advance_point(tip, pull, eased, self._of(parts, _bundle_point)))


class TickParts(_Kept):
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
        answer = _advance_tick(target, draws, waited, self._of(parts, _bundle_tick))
        return answer & REQUESTS, answer >> REQUEST_BITS


@structref.register
class _PointType(types.StructRef):
    """numba's type of a bundle for a point."""


@structref.register
class _TickType(types.StructRef):
    """numba's type of a bundle for a tick."""


class _PointBundle(structref.StructRefProxy):
    """The bundle as the interpreter sees it."""


class _TickBundle(structref.StructRefProxy):
    """The bundle as the interpreter sees it."""


structref.define_proxy(_PointBundle, _PointType, ["surface", "track", "points", "contact", "constants"])
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
def _bundle_point(
    surface: Surface, track: TipTrack, points: ControlPoints, contact: Contact, constants: PointConstants
) -> Any:
    return _PointBundle(surface, track, points, contact, constants)


@kernel
def _advance_point(tip: Array, pull: Array, eased: float, of: Any) -> int:
    return advance_point(tip, pull, eased, of.surface, of.track, of.points, of.contact, of.constants)


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
