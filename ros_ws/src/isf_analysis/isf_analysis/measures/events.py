"""Events of a part: by kind, by severity, and the contour they came at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from isf_core.contour import ContourResult
from isf_core.events import Event, EventKind

from isf_analysis.measures.percent import in_percent

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
    """All events of one kind.

    Attributes
    ----------
    kind, count : value of EventKind, how many ; first : of them
    value, limit : SI, farthest from (mostly above) its limit ; text : that of the worst, and of kinds without a limit
        all different ones
    """

    kind: int
    count: int
    first: Event
    value: float
    limit: float
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


def groups(events: Sequence[Event], results: Sequence[ContourResult] = ()) -> tuple[EventGroup, ...]:
    """Events by kind, most severe first; kinds this version does not know come first.

    An event is told when it begins. How far a support force that sheds chips rose afterwards is seen in ``results``.
    """
    found = []
    for kind in sorted({event.kind for event in events}, key=_rank):
        same = sorted((event for event in events if event.kind == kind), key=lambda event: event.time)
        worst = max(same, key=_excess)
        text = worst.text if np.isfinite(_excess(worst)) else "; ".join(dict.fromkeys(event.text for event in same))
        group = EventGroup(kind, len(same), same[0], worst.value, worst.limit, text)
        found.append(_by_force(group, results) if kind == EventKind.GALLING else group)
    return tuple(found)


def contour_at(results: Sequence[ContourResult], time: float) -> int | None:
    """Index of the contour that was being formed at ``time`` (s); None between contours."""
    for result in results:
        if result.start - 1e-9 <= time <= result.end + 1e-9:
            return result.index
    return None


def _by_force(group: EventGroup, results: Sequence[ContourResult]) -> EventGroup:
    """The ``group`` of chips with the largest support force at the points of the contours, and how many points have
    more than the limit."""
    forces = [np.linalg.norm(result.support_force, axis=1) for result in results if len(result.support_force)]
    force = np.concatenate(forces) if forces else np.empty(0)
    force = force[np.isfinite(force)]
    largest = float(force.max(initial=0.0))
    if not largest > group.limit:
        return group
    share = f"passed at {in_percent(float(np.mean(force > group.limit)), 0):g} % of the points"
    text = f"the support tool sheds chips: up to {largest:.0f} N, limit {group.limit:.0f} N, {share}"
    return replace(group, value=max(largest, group.value), text=text)


def _rank(kind: int) -> tuple[int, int]:
    return (SEVERITY.index(EventKind(kind)) if kind in SEVERITY else -1, kind)


def _excess(event: Event) -> float:
    """How far beyond its limit; the support force of a lost contact is below its own."""
    excess = event.value - event.limit if event.kind != EventKind.CONTACT_LOST else event.limit - event.value
    return excess if np.isfinite(excess) else -np.inf
