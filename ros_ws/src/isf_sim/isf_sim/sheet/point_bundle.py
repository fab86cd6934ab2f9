"""State and constants handed to a kernel as one object instead of many arrays; here to that of a point.

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
from isf_sim.sheet.control_points import ControlPoints
from isf_sim.sheet.sheet_point import Contact, PointConstants, advance_point
from isf_sim.sheet.surface import Surface, TipTrack


class KeptBundle:
    """A bundle that is made again when one of its parts is another object; never part of a state."""

    constant_of_state = True

    def __init__(self) -> None:
        self._parts: tuple[Any, ...] = ()
        self._bundle: Any = None

    def of(self, parts: tuple[Any, ...], make: Callable[..., Any]) -> Any:
        """The bundle that ``make`` makes of ``parts``."""
        if not (len(parts) == len(self._parts) and all(map(is_, parts, self._parts))):
            self._parts, self._bundle = parts, make(*parts)
        return self._bundle

    def __deepcopy__(self, memo: dict[int, Any]) -> KeptBundle:
        return type(self)()


class PointParts(KeptBundle):
    """Surface, track, points, contact and constants for :func:`isf_sim.sheet.sheet_point.advance_point`."""

    def advance(
        self,
        tip: Array,
        pull: Array,
        eased: float,
        parts: tuple[Surface, TipTrack, ControlPoints, Contact, PointConstants],
    ) -> int:
        """:func:`isf_sim.sheet.sheet_point.advance_point` with ``parts``."""
        return int(_advance_point(tip, pull, eased, self.of(parts, _bundle_point)))


@structref.register
class _PointType(types.StructRef):
    """numba's type of a bundle for a point."""


class _PointBundle(structref.StructRefProxy):
    """The bundle as the interpreter sees it."""


structref.define_proxy(_PointBundle, _PointType, ["surface", "track", "points", "contact", "constants"])


@kernel
def _bundle_point(
    surface: Surface, track: TipTrack, points: ControlPoints, contact: Contact, constants: PointConstants
) -> Any:
    return _PointBundle(surface, track, points, contact, constants)


@kernel
def _advance_point(tip: Array, pull: Array, eased: float, of: Any) -> int:
    return advance_point(tip, pull, eased, of.surface, of.track, of.points, of.contact, of.constants)
