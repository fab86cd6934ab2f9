"""Events: what happens to sheet or machine while a part is formed, as the messages of ``machine/event`` tell it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from isf_core.errors import ErrorCode, IsfError, told


class EventKind(IntEnum):
    """Kinds of events, values as in ``isf_msgs/msg/MachineEvent``."""

    FRACTURE = 1
    GALLING = 2
    BUCKLING = 3
    CONTACT_LOST = 4
    DIE_CONTACT = 5
    SATURATION = 6
    LOAD_CELL = 7
    FORCE_UNKNOWN = 8


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes
    ----------
    kind : value of :class:`EventKind`, or of a later version's kind
    time : s, as in the ticks of the results ; position : (x, y, z) m, frame ``sheet``; NaN: not at a place
    value, limit : the quantity at fault and its limit, SI, as ``text`` says ; text : for people
    """

    kind: int
    time: float
    position: tuple[float, float, float]
    value: float
    limit: float
    text: str

    @property
    def has_place(self) -> bool:
        """False for what did not happen at a place of the sheet."""
        return all(math.isfinite(value) for value in self.position)

    @property
    def name(self) -> str:
        """The kind in words."""
        return kind_name(self.kind)


def torn(events: Iterable[Event], began: float = 0.0) -> IsfError | None:
    """Why the part is lost, SHEET_TORN with the place, when its sheet tore; else None.

    ``began``: s, when the part began, by the clock of the events.
    """
    for event in events:
        if event.kind == EventKind.FRACTURE:
            return IsfError(
                ErrorCode.SHEET_TORN,
                event.text,
                where=f"after {event.time - began:.1f} s",
                advice="make the wall flatter, take another material, larger steps or more support force",
            )
    return None


def cell_event(error: IsfError, tool: int, time: float, *, lost: bool) -> Event:
    """What happened to a load cell of ``tool`` at ``time`` s; ``lost``: it no longer tells the force."""
    kind = EventKind.FORCE_UNKNOWN if lost else EventKind.LOAD_CELL
    nan = float("nan")
    return Event(kind, time, (nan, nan, nan), nan, nan, f"tool {tool}: {error}")


def force_unknown(events: Iterable[Event]) -> IsfError | None:
    """Why the load cells no longer tell the force, with the code of what happened to them; None: they do."""
    for event in events:
        if event.kind == EventKind.FORCE_UNKNOWN:
            return told(event.text) or IsfError(ErrorCode.WRENCH_LOST, event.text)
    return None


def kind_name(kind: int) -> str:
    """The kind in words; its number when this version does not know it."""
    try:
        return EventKind(kind).name.lower().replace("_", " ")
    except ValueError:
        return f"kind {kind}"
