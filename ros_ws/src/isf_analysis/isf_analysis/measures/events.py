"""What happened to sheet or machine while a part was formed: the messages of ``machine/event``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

import numpy as np
from isf_core.contour import ContourResult


class EventKind(IntEnum):
    """Kinds of events, values as in isf_msgs/MachineEvent."""

    FRACTURE = 1
    GALLING = 2
    BUCKLING = 3
    CONTACT_LOST = 4
    DIE_CONTACT = 5
    SATURATION = 6


SEVERITY = (
    EventKind.FRACTURE,
    EventKind.BUCKLING,
    EventKind.SATURATION,
    EventKind.GALLING,
    EventKind.CONTACT_LOST,
    EventKind.DIE_CONTACT,
)
"""Most severe first: the part is lost, the shape is, the control is, the surface is, the support is, nothing is."""

HARMLESS = frozenset({EventKind.DIE_CONTACT})
"""Kinds that belong to a good part."""


@dataclass(frozen=True)
class PartEvent:
    """One event.

    Attributes
    ----------
    kind : value of :class:`EventKind`, or of a later version's kind
    time : s, as in the ticks of the results ; position : (x, y, z) m, frame ``sheet``
    value, limit : the quantity at fault and its limit, SI, as ``text`` says ; text : for people
    """

    kind: int
    time: float
    position: tuple[float, float, float]
    value: float
    limit: float
    text: str

    @property
    def name(self) -> str:
        """The kind in words."""
        return kind_name(self.kind)


class _Told(Protocol):
    """What a machine tells: attributes as in :class:`PartEvent`, whichever class they are of."""

    @property
    def kind(self) -> int: ...
    @property
    def time(self) -> float: ...
    @property
    def position(self) -> tuple[float, float, float]: ...
    @property
    def value(self) -> float: ...
    @property
    def limit(self) -> float: ...
    @property
    def text(self) -> str: ...


@dataclass(frozen=True)
class EventGroup:
    """All events of one kind: how many, the first, the one farthest from (mostly above) its limit."""

    kind: int
    count: int
    first: PartEvent
    worst: PartEvent

    @property
    def harmless(self) -> bool:
        """True when this kind belongs to a good part."""
        return self.kind in HARMLESS


def event_of(told: _Told) -> PartEvent:
    """Event as the machine in this process tells it."""
    x, y, z = told.position
    return PartEvent(
        int(told.kind),
        float(told.time),
        (float(x), float(y), float(z)),
        float(told.value),
        float(told.limit),
        told.text,
    )


def event_of_message(message: Any) -> PartEvent:
    """Event of an ``isf_msgs/MachineEvent`` from a bag."""
    stamp, place = message.header.stamp, message.position
    time = int(stamp.sec) + int(stamp.nanosec) * 1e-9
    return PartEvent(int(message.kind), time, (place.x, place.y, place.z), message.value, message.limit, message.text)


def kind_name(kind: int) -> str:
    """The kind in words; its number when this version does not know it."""
    try:
        return EventKind(kind).name.lower().replace("_", " ")
    except ValueError:
        return f"kind {kind}"


def groups(events: Sequence[PartEvent]) -> tuple[EventGroup, ...]:
    """Events by kind, most severe first; kinds this version does not know come first."""
    found = []
    for kind in sorted({event.kind for event in events}, key=_rank):
        same = sorted((event for event in events if event.kind == kind), key=lambda event: event.time)
        found.append(EventGroup(kind, len(same), same[0], max(same, key=_excess)))
    return tuple(found)


def contour_at(results: Sequence[ContourResult], time: float) -> int | None:
    """Index of the contour that was being formed at ``time`` (s); None between contours."""
    for result in results:
        if result.start - 1e-9 <= time <= result.end + 1e-9:
            return result.index
    return None


def _rank(kind: int) -> tuple[int, int]:
    return (SEVERITY.index(EventKind(kind)) if kind in SEVERITY else -1, kind)


def _excess(event: PartEvent) -> float:
    """How far beyond its limit; the support force of a lost contact is below its own."""
    excess = event.value - event.limit if event.kind != EventKind.CONTACT_LOST else event.limit - event.value
    return excess if np.isfinite(excess) else -np.inf
