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

import numpy as np
from numba import types
from numba.experimental import structref
from numpy.typing import NDArray

from isf_sim.control_points import ControlPoints
from isf_sim.jit import kernel
from isf_sim.load_cell import CellState
from isf_sim.machine_tick import Axes, MachineConstants, advance_tick
from isf_sim.role import Role
from isf_sim.sheet_point import Contact, PointConstants, advance_point
from isf_sim.squeeze import Squeeze
from isf_sim.surface import Surface, TipTrack

Array = NDArray[np.float64]


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
    """Surface, track, points, contact and constants for :func:`isf_sim.sheet_point.advance_point`."""

    def advance(
        self,
        tip: Array,
        pull: Array,
        eased: float,
        parts: tuple[Surface, TipTrack, ControlPoints, Contact, PointConstants],
    ) -> int:
        """:func:`isf_sim.sheet_point.advance_point` with ``parts``."""
        return int(_advance_point(tip, pull, eased, self._of(parts, _bundle_point)))


class TickParts(_Kept):
    """Everything for :func:`isf_sim.machine_tick.advance_tick` but target and noise."""

    def advance(
        self,
        target: Array,
        draws: Array,
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
        ],
    ) -> int:
        """:func:`isf_sim.machine_tick.advance_tick` with ``parts``."""
        return int(_advance_tick(target, draws, self._of(parts, _bundle_tick)))


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
    ["axes", "surface", "track", "points", "contact", "squeeze", "role", "cell_1", "cell_2", "constants"],
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
) -> Any:
    return _TickBundle(axes, surface, track, points, contact, squeeze, role, cell_1, cell_2, constants)


@kernel
def _advance_tick(target: Array, draws: Array, of: Any) -> int:
    return advance_tick(
        target,
        draws,
        of.axes,
        of.surface,
        of.track,
        of.points,
        of.contact,
        of.squeeze,
        of.role,
        of.cell_1,
        of.cell_2,
        of.constants,
    )
