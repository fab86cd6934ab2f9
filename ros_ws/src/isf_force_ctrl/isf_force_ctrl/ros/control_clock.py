"""Control ticks by the clock, in step with the load cells: a tick answers a wrench the moment it comes.

Ticks are due on a grid of periods. The grid follows the arrival of the wrenches (at most one per cent faster or slower
than its nominal rate), so a pair that comes about when a tick is due makes that tick at once, in the thread that
received it. Where none comes in time (lost, late, or a sensor with another rate) an own thread makes the tick with the
newest wrenches 0.4 periods later: targets never wait for a message. Ticks that are late are counted, never
hidden.
"""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable

from isf_ros.thread_priority import Privileges, RealTimeSettings, acquire, release

from isf_force_ctrl.supervision.latency import Durations

EARLY = 0.25
"""Share of a period that a pair of wrenches may come before its tick is due and still be answered at once."""

PATIENCE = 0.4
"""Share of a period that a tick waits for its wrenches."""

LATE = 1.0
"""Share of a period after which a tick is late: the next one is due."""

FOLLOWED = 0.05
"""Share of the deviation between the arrival of the wrenches and the grid by which the grid moves in one tick."""

MAXIMUM_FOLLOWED = 0.01
"""Share of a period that the grid moves in one tick, at most."""

RESYNCHRONISE = 0.1
"""s of delay beyond which missed ticks are dropped instead of caught up."""


class PeriodicLoop:
    """Calls ``step`` ``rate`` times per second until :meth:`stop`; never twice at the same time.

    ``clock`` (s, monotonic) is for tests.
    """

    def __init__(
        self,
        rate: float,
        step: Callable[[], None],
        settings: RealTimeSettings = RealTimeSettings(),  # noqa: B008 - frozen
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._period = 1.0 / rate
        self._step, self._settings, self._clock = step, settings, clock
        self._thread: threading.Thread | None = None
        self._end = threading.Event()
        self._turn = threading.Lock()
        self._due = clock()
        self._met = self._early = False
        self.ticks = self.late_ticks = 0
        """Ticks so far; ticks that ended :data:`LATE` of a period after they were due, and ticks that were dropped."""
        self.answered = 0
        """Ticks made by the wrenches that they used."""
        self.delay = Durations()
        """s, from the time a tick was due to its end."""
        self.privileges = Privileges()

    def start(self) -> None:
        """Begin, with what the system grants of ``settings``; the collector is frozen until :meth:`stop`."""
        gc.collect()
        gc.freeze()
        gc.disable()
        self.privileges = acquire(self._settings)
        self._end.clear()
        self._due, self._met, self._early = self._clock() + self._period, False, False
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread, wait for it, and give back what :meth:`start` took. Not from within ``step``."""
        self._end.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            release(self.privileges)
            gc.enable()
            gc.unfreeze()

    def offer(self) -> None:
        """A new pair of wrenches is there: make the tick now if one is about due."""
        with self._turn:
            now = self._clock()
            apart = now - self._due
            if self._end.is_set():
                return
            if self._met and apart < -EARLY * self._period:
                self._early = True  # it is kept for the next tick
                return
            if not self._met:  # the grid begins with the first pair
                self._met, self._due, apart = True, now, 0.0
            self.answered += 1
            most = MAXIMUM_FOLLOWED * self._period
            self._tick(max(-most, min(most, FOLLOWED * apart)))

    def tick_if_overdue(self) -> float:
        """Make the tick that waited long enough for its wrenches; returns s until the next look is worth it."""
        with self._turn:
            left = self._due + PATIENCE * self._period - self._clock()
            if left <= 0.0:  # a pair that came too early to be answered at once pulls the grid towards it
                self._tick(-MAXIMUM_FOLLOWED * self._period if self._early else 0.0)
                left = self._due + PATIENCE * self._period - self._clock()
            return left

    def _tick(self, shift: float) -> None:
        """One tick; the grid moves by ``shift`` s."""
        due, self._early = self._due, False
        self._step()
        over = self._clock() - due
        self.delay.add(over)
        self.ticks += 1
        self._due = due + self._period + shift
        if over > LATE * self._period:
            self.late_ticks += 1
            if over > RESYNCHRONISE:
                dropped = int(over / self._period)
                self.late_ticks += dropped
                self._due += dropped * self._period

    def _run(self) -> None:
        while not self._end.is_set():
            left = self.tick_if_overdue()
            if left > 0:
                time.sleep(left)  # until the next tick is due: this thread is the clock of the loop in real time

    def values(self) -> dict[str, object]:
        """For ``/diagnostics``."""
        return {
            "real_time_ticks": self.ticks,
            "answered_ticks": self.answered,
            **self.delay.values("tick_delay"),
            **self.privileges.values(),
        }
