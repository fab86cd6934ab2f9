"""Watchdog on the time of receipt: sender stamps and liveliness settings do not tell that a message came."""

from __future__ import annotations

import time
from collections.abc import Callable

DISTANCE_FOLLOWED = 0.02
"""Share of the newest distance in the usual one: the mean of about fifty."""

LONGEST_FOLLOWED = 3.0
"""Usual distances as which a longer one counts: silences are not what the sender usually does."""


class ReceiveWatchdog:
    """Tells whether something was received within ``timeout`` s of ``clock`` (monotonic by default)."""

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.timeout = timeout
        self._clock = clock
        self._last: float | None = None
        self.distance = 0.0
        """s, usual time between two receipts; 0: nothing was received twice."""
        self._distances = 0

    def feed(self) -> None:
        """Something was received."""
        now = self._clock()
        if self._last is not None:
            apart = now - self._last
            if self._distances * DISTANCE_FOLLOWED >= 1.0:
                apart = min(apart, LONGEST_FOLLOWED * self.distance)
            self._distances += 1
            self.distance += max(DISTANCE_FOLLOWED, 1.0 / self._distances) * (apart - self.distance)
        self._last = now

    def excuse(self, seconds: float) -> None:
        """``seconds`` of the time since the last receipt do not count: nothing could be received then."""
        if self._last is not None:
            self._last = min(self._last + seconds, self._clock())

    def clear(self) -> None:
        """Forget: nothing is expected until the next :meth:`feed`."""
        self._last, self.distance, self._distances = None, 0.0, 0

    @property
    def fed(self) -> bool:
        """True when something was received since the start or the last :meth:`clear`."""
        return self._last is not None

    def age(self) -> float:
        """s since the last receipt; infinite when nothing was received."""
        return float("inf") if self._last is None else self._clock() - self._last

    def expired(self) -> bool:
        """True when something was received once and nothing since ``timeout``."""
        return self._last is not None and self.age() > self.timeout


class RegularLook:
    """Tells whether this process itself stood still: a look that should be taken often is late.

    What came meanwhile has still to be received, so a silence that such a look finds says nothing of the sender.
    """

    def __init__(self, longest: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._longest = longest
        self._clock = clock
        self._last: float | None = None

    def late(self) -> bool:
        """To be called at every look: True when the one before is more than ``longest`` s ago."""
        now = self._clock()
        before, self._last = self._last, now
        return before is not None and now - before > self._longest
