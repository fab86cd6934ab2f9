"""A step per period of the wall clock, in a thread with absolute deadlines; late periods are counted, never made up."""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections.abc import Callable

SWITCH_INTERVAL = 1.0e-4
"""s after which a thread that computes in the interpreter gives way to the one that ticks; 5 ms otherwise."""


class PeriodicThread:
    """Calls ``step(n)`` for period n = 0, 1, ... at ``rate`` Hz until :meth:`stop`.

    A step that ends after its deadline makes the thread skip the periods it missed, so that period n always begins
    n / rate after the start; every missed period counts as late. ``step`` sees the gap in its numbers.

    From its making to :meth:`stop` the interpreter's other threads give way soon, and what exists is out of the garbage
    collector's way: a full collection of it takes longer than many periods. What is made later is collected as ever.
    """

    def __init__(self, rate: float, step: Callable[[int], None]) -> None:
        self.late = 0
        self._rate = rate
        self._step = step
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="machine", daemon=True)
        gc.collect()
        gc.freeze()
        self._interval = sys.getswitchinterval()
        sys.setswitchinterval(min(SWITCH_INTERVAL, self._interval))

    def start(self) -> None:
        """Begin with period 0 now."""
        self._thread.start()

    def stop(self) -> None:
        """End after the present step; returns when the thread has ended."""
        self._ended.set()
        self.give_back()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def give_back(self) -> None:
        """Let the interpreter be as it was before."""
        sys.setswitchinterval(self._interval)
        gc.unfreeze()

    def _run(self) -> None:
        start = time.monotonic()
        period = 0
        while not self._ended.is_set():
            self._step(period)
            elapsed = (time.monotonic() - start) * self._rate
            following = max(period + 1, int(elapsed) + 1)
            self.late += following - period - 1
            period = following
            self._ended.wait(max(0.0, start + period / self._rate - time.monotonic()))
