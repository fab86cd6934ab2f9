"""A bag written anew: one whole file of what can be read of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rosbags.interfaces import Connection

from isf_analysis.bag.bag_file import BagFile, Storage, check_free
from isf_analysis.bag.open_bag import open_bag


@dataclass(frozen=True)
class Copied:
    """What came into a copy; ``notes`` tell what had to be done and what is damaged."""

    path: Path
    topics: int
    messages: int
    notes: tuple[str, ...]


def copy_bag(source: Path, output: Path, storage: Storage | None = None) -> Copied:
    """Write all that can be read of the bag ``source``, of a resumed part all its bags, as the new bag ``output``.

    Messages keep their bytes, times of receipt, types and profiles of delivery.

    Raises
    ------
    IsfError : BAG_UNREADABLE; BAG_NOT_WRITABLE (``output`` exists, or the disk refuses)
    """
    check_free(output)
    with open_bag(source) as bag:
        found = bag.connections
        target = BagFile(output, storage)
        count = 0
        try:
            kept: dict[tuple[str, str], Connection] = {
                (item.topic, item.msgtype): target.add_like(item, bag.types) for item in found
            }
            for block in bag.blocks(found):
                connection = kept[block.connection.topic, block.connection.msgtype]
                for number, time in enumerate(block.times.tolist()):
                    target.write(connection, time, block.message(number).tobytes())
                count += len(block)
        finally:
            target.close()
        return Copied(output, len(kept), count, tuple(bag.notes))
