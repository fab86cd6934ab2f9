"""Signs of life of a node whose executor is in one long callback: slow is told from dead; free of ROS."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

LONGEST_BUSY = 20.0
"""s after which a node that is still in the same callback hangs, and gives no more signs of life (assumed)."""


class BusyHeartbeat:
    """A thread that calls ``publish(seconds)`` every ``period`` s while nobody has called :meth:`served` for longer.

    It ends with :meth:`stop`; a ``publish`` that raises ends it too.
    """

    def __init__(
        self,
        publish: Callable[[float], None],
        period: float,
        longest: float = LONGEST_BUSY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._publish, self._period, self._longest, self._clock = publish, period, longest, clock
        self._served = clock()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="busy_heartbeat", daemon=True)
        self._thread.start()

    def served(self) -> None:
        """The executor is at work: it has just published a sign of life itself."""
        self._served = self._clock()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._stopped.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        while not self._stopped.wait(self._period):
            busy = self._clock() - self._served
            if 2.0 * self._period < busy <= self._longest:
                try:
                    self._publish(busy)
                except Exception:  # the node leaves the graph at this moment
                    return
