"""A recording in progress: a thread that writes what it is given, so that a slow disk never stops who gives.

The queue is unlimited: nothing is dropped while memory lasts; ``longest_queue`` tells how far the disk fell behind.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from isf_core.errors import IsfError
from rosbags.interfaces import Connection

from isf_analysis.bag.bag_file import BagFile
from isf_analysis.bag.topics import Topic

FLUSH_PERIOD = 1.0
"""s between two hand-overs to the operating system: what a killed recorder can lose of the streams."""

AT_ONCE = ("LATCHED", "EVENT")
"""Kinds of delivery that are handed over as they come: contours, their results, scans."""

Message = tuple[Connection, int, bytes]
"""Topic, receive time in ns since 1970, serialised message."""


class Recording:
    """A bag being filled by a thread of its own.

    ``topics`` are (topic, absolute name) pairs; ``connections`` has the handles to :meth:`put` messages with, in
    the same order.

    Raises
    ------
    IsfError : BAG_NOT_WRITABLE when the bag cannot be made, or from :meth:`close` when it could not be written
    """

    def __init__(self, path: Path, topics: Sequence[tuple[Topic, str]], *, compression: str = "none") -> None:
        self.path = path
        self.written = 0
        self.longest_queue = 0
        self.error: IsfError | None = None
        self._bag = BagFile(path, compression=compression)
        self.connections = [self._bag.add(topic, name) for topic, name in topics]
        kinds = zip(topics, self.connections, strict=True)
        self._at_once = {connection.id for (topic, _), connection in kinds if topic.delivery in AT_ONCE}
        self._queue: queue.SimpleQueue[Sequence[Message] | None] = queue.SimpleQueue()
        self._waiting = 0
        self._thread = threading.Thread(target=self._write, name="bag writer", daemon=True)
        self._thread.start()

    def add(self, messages: Sequence[Message]) -> None:
        """Take messages to be written; returns at once."""
        self._waiting += len(messages)
        self.longest_queue = max(self.longest_queue, self._waiting - self.written)
        self._queue.put(messages)

    def close(self) -> None:
        """Write what is queued and close the bag; raises the error that stopped the writing, if any."""
        self._queue.put(None)
        self._thread.join()
        self._bag.close()
        if self.error is not None:
            raise self.error

    def _write(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                messages = self._queue.get(timeout=FLUSH_PERIOD)
            except queue.Empty:
                messages = ()
            if messages is None:
                return
            if self.error is not None:
                continue  # the disk refused: go on taking, so that closing does not hang
            try:
                for connection, timestamp, data in messages:
                    self._bag.write(connection, timestamp, data)
                self.written += len(messages)
                at_once = any(connection.id in self._at_once for connection, _, _ in messages)
                if at_once or time.monotonic() - flushed > FLUSH_PERIOD:
                    self._bag.flush()
                    flushed = time.monotonic()
            except IsfError as error:
                self.error = error
