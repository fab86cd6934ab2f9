"""Messages of a bag in the order of receipt, from a time or a contour on, with what was latched before."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count

from isf_core.contour import contour_label
from isf_core.errors import ErrorCode, IsfError
from rosbags.interfaces import Connection, QosDurability

from isf_analysis.bag import topics
from isf_analysis.bag.bag_reader import last_part, namespace_of
from isf_analysis.bag.open_bag import OpenBag, unreadable

WINDOW = 1_000_000_000
"""ns by which a message may lie in the file behind later ones: chunks and batches overlap."""


@dataclass(frozen=True)
class Recorded:
    """A serialised message: time of receipt in ns since 1970, topic, and bytes."""

    time: int
    connection: Connection
    data: bytes


def in_order(bag: OpenBag, connections: Sequence[Connection], begin: int = 0) -> Iterator[Recorded]:
    """Messages of ``connections`` received from ``begin`` ns on; no more than a second of them is held."""
    waiting: list[tuple[int, int, Recorded]] = []
    number = count()
    for block in bag.blocks(connections):
        times = block.times.tolist()
        for k, time in enumerate(times):
            if time >= begin:
                message = Recorded(time, block.connection, block.message(k).tobytes())
                heapq.heappush(waiting, (time, next(number), message))
        safe = block.since - WINDOW
        while waiting and waiting[0][0] < safe:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def is_latched(connection: Connection) -> bool:
    """True for a topic whose last message late subscribers get."""
    profiles = getattr(connection.ext, "offered_qos_profiles", [])
    return any(profile.durability == QosDurability.TRANSIENT_LOCAL for profile in profiles)


def latched_before(bag: OpenBag, connections: Sequence[Connection], begin: int) -> list[Recorded]:
    """The last message before ``begin`` ns of every latched topic, oldest first."""
    last: dict[int, Recorded] = {}
    latched = [connection for connection in connections if is_latched(connection)]
    for block in bag.blocks(latched) if begin else ():
        for k, time in enumerate(block.times.tolist()):
            known = last.get(block.connection.id)
            if time < begin and (known is None or time >= known.time):
                last[block.connection.id] = Recorded(time, block.connection, block.message(k).tobytes())
    return sorted(last.values(), key=lambda item: item.time)


def begin_of_contour(bag: OpenBag, index: int, namespace: str | None = None) -> int:
    """ns since 1970, when contour ``index`` (from 0) of the last part was handed to springback correction; of the cell
    ``namespace``, None: the only one.

    Raises
    ------
    IsfError : BAG_INCOMPLETE, not a bag of a cell, or this contour is not in it; BAG_UNREADABLE, it is damaged;
        FILE_FIELD, it holds several cells, or none of that name
    """
    name = f"{namespace_of(bag, namespace)}/{topics.NOMINAL.name}"
    part = last_part(bag, namespace)
    connections = [connection for connection in bag.connections if connection.topic == name]
    try:
        indices = {
            message.index: time
            for time, message in bag.messages(connections)
            if message.plan_id == part.plan_id and part.holds(time)
        }
    except Exception as error:  # a damaged file shows in as many ways as there are bytes
        raise unreadable(bag.path, f"is damaged: {error}") from error
    if index not in indices:
        held = f"contours {min(indices) + 1} to {max(indices) + 1}" if indices else "no contour"
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            f"does not hold {contour_label(index)}",
            where=str(bag.path),
            advice=f"it holds {held}",
        )
    return indices[index]
