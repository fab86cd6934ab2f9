"""Events of a part: by kind, by severity, and the contour they came at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from isf_core.contour import ContourResult
from isf_core.events import Event, EventKind

SEVERITY = (
    EventKind.FRACTURE,
    EventKind.BUCKLING,
    EventKind.FORCE_UNKNOWN,
    EventKind.LOAD_CELL,
    EventKind.SATURATION,
    EventKind.GALLING,
    EventKind.CONTACT_LOST,
    EventKind.DIE_CONTACT,
)
"""Most severe first: the part is lost, the shape is, the measured force is, the control is, the surface is, the support
is, nothing is."""

HARMLESS = frozenset({EventKind.DIE_CONTACT})
"""Kinds that belong to a good part."""


@dataclass(frozen=True)
class EventGroup:
    """All events of one kind: how many, the first, the one farthest from (mostly above) its limit; ``text`` is that of
    the worst, and of kinds without a limit all different ones."""

    kind: int
    count: int
    first: Event
    worst: Event
    text: str

    @property
    def harmless(self) -> bool:
        """True when this kind belongs to a good part."""
        return self.kind in HARMLESS


def event_of_message(message: Any) -> Event:
    """Event of an ``isf_msgs/MachineEvent`` from a bag."""
    stamp, place = message.header.stamp, message.position
    time = int(stamp.sec) + int(stamp.nanosec) * 1e-9
    return Event(int(message.kind), time, (place.x, place.y, place.z), message.value, message.limit, message.text)


def groups(events: Sequence[Event]) -> tuple[EventGroup, ...]:
    """Events by kind, most severe first; kinds this version does not know come first."""
    found = []
    for kind in sorted({event.kind for event in events}, key=_rank):
        same = sorted((event for event in events if event.kind == kind), key=lambda event: event.time)
        worst = max(same, key=_excess)
        text = worst.text if np.isfinite(_excess(worst)) else "; ".join(dict.fromkeys(event.text for event in same))
        found.append(EventGroup(kind, len(same), same[0], worst, text))
    return tuple(found)


def contour_at(results: Sequence[ContourResult], time: float) -> int | None:
    """Index of the contour that was being formed at ``time`` (s); None between contours."""
    for result in results:
        if result.start - 1e-9 <= time <= result.end + 1e-9:
            return result.index
    return None


def _rank(kind: int) -> tuple[int, int]:
    return (SEVERITY.index(EventKind(kind)) if kind in SEVERITY else -1, kind)


def _excess(event: Event) -> float:
    """How far beyond its limit; the support force of a lost contact is below its own."""
    excess = event.value - event.limit if event.kind != EventKind.CONTACT_LOST else event.limit - event.value
    return excess if np.isfinite(excess) else -np.inf
