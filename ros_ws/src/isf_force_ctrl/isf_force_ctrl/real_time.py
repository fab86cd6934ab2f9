"""A periodic loop with absolute deadlines in a thread of its own, for control in real time.

Python cannot promise deadlines; it can keep the tick count, measure how late it was, keep its garbage collector
quiet and ask for a real-time priority. Late ticks are counted, never hidden.
"""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Callable

PRIORITY = 60
"""SCHED_FIFO priority asked for (1-99)."""

RESYNCHRONISE = 0.1
"""s of delay beyond which missed ticks are dropped instead of caught up."""


class PeriodicLoop:
    """Calls ``step`` ``rate`` times per second until :meth:`stop`."""

    def __init__(self, rate: float, step: Callable[[], None]) -> None:
        self._period = 1.0 / rate
        self._step = step
        self._thread: threading.Thread | None = None
        self._end = threading.Event()
        self.late_ticks = 0
        """Ticks that ended after their deadline, and ticks that were dropped."""
        self.real_time_priority = False
        """The system granted SCHED_FIFO."""

    def start(self) -> None:
        """Begin; the collector is frozen until :meth:`stop`."""
        gc.collect()
        gc.freeze()
        gc.disable()
        self._end.clear()
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._end.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            gc.enable()
            gc.unfreeze()

    def _run(self) -> None:
        self.real_time_priority = _ask_for_priority()
        deadline = time.monotonic()
        while not self._end.is_set():
            deadline += self._period
            self._step()
            left = deadline - time.monotonic()
            if left > 0:
                time.sleep(left)
                continue
            self.late_ticks += 1
            if -left > RESYNCHRONISE:
                dropped = int(-left / self._period)
                self.late_ticks += dropped
                deadline += dropped * self._period


def _ask_for_priority() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (OSError, AttributeError):  # not permitted, or not a Linux
        return False
    return True
