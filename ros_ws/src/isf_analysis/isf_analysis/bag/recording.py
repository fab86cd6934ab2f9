"""A recording in progress: a thread that writes what it is given, so that a slow disk never stops who gives.

What waits for the disk is bounded. Beyond it messages of streams are left out and counted; contours, their results,
scans and events never are.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from isf_core.errors import IsfError

from isf_analysis.bag.bag_file import BagFile, Storage
from isf_analysis.bag.topics import Topic

FLUSH_PERIOD = 1.0
"""s between two hand-overs to the operating system: what a killed recorder can lose of the streams."""

AT_ONCE = ("LATCHED", "EVENT", "CHANGES")
"""Kinds of delivery that are handed over as they come: contours, their results, scans."""

Message = tuple[int, int, bytes]
"""Number of the topic in the recording, receive time in ns since 1970, serialised message."""


class Recording:
    """A bag being filled by a thread of its own.

    ``topics`` are (topic, absolute name) pairs, by whose number messages are given. At most ``queue_size`` bytes of
    messages wait for the disk; ``left_out`` counts what did not fit, by number of the topic. The messages ``before`` it
    began are written first, all of them: they are in memory already.

    Raises
    ------
    IsfError : BAG_NOT_WRITABLE when the bag cannot be made, or from :meth:`close` when it could not be written
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[tuple[Topic, str]],
        storage: Storage | None = None,
        *,
        queue_size: int = 256_000_000,
        before: Sequence[Message] = (),
    ) -> None:
        self.path = path
        self.written = 0
        self.longest_queue = 0
        self.left_out: Counter[int] = Counter()
        self.error: IsfError | None = None
        self._bag = BagFile(path, storage)
        self._connections = [self._bag.add(topic, name) for topic, name in topics]
        self._at_once = {number for number, (topic, _) in enumerate(topics) if topic.delivery in AT_ONCE}
        self._queue: queue.SimpleQueue[Sequence[Message] | None] = queue.SimpleQueue()
        self._queue_size = queue_size + sum(len(data) for _, _, data in before)
        self._taken = self._taken_bytes = 0  # of this thread
        self._written_bytes = 0  # of the writer's
        self._thread = threading.Thread(target=self._write, name="bag writer", daemon=True)
        self._thread.start()
        self.add(before)

    def add(self, messages: Sequence[Message]) -> None:
        """Take messages to be written; returns at once."""
        size = sum(len(data) for _, _, data in messages)
        if self._taken_bytes - self._written_bytes + size > self._queue_size:
            self.left_out.update(number for number, _, _ in messages if number not in self._at_once)
            messages = [message for message in messages if message[0] in self._at_once]
            size = sum(len(data) for _, _, data in messages)
        if not messages:
            return
        self._taken += len(messages)
        self._taken_bytes += size
        self.longest_queue = max(self.longest_queue, self._taken - self.written)
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
                for number, timestamp, data in messages:
                    self._bag.write(self._connections[number], timestamp, data)
                self.written += len(messages)
                self._written_bytes += sum(len(data) for _, _, data in messages)
                at_once = any(number in self._at_once for number, _, _ in messages)
                if at_once or time.monotonic() - flushed > FLUSH_PERIOD:
                    self._bag.flush()
                    flushed = time.monotonic()
            except IsfError as error:
                self.error = error
