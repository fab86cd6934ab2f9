"""Whether targets still come, and whose fault it is when they do not."""

from __future__ import annotations

import time
from collections.abc import Callable

from isf_node.watchdog import ReceiveWatchdog

LARGEST_DRY = 2
"""Ticks without a new pair of targets that are no gap in real time."""


class TargetStream:
    """The stream of targets as the machine sees it; ``clock`` (s, monotonic) is for tests.

    Attributes
    ----------
    following : True from the first pair of targets until the stream has ended
    lost : pairs that did not come
    """

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.following = False
        self.lost = 0
        self._watchdog = ReceiveWatchdog(timeout, clock)
        self._dry = 0

    @property
    def timeout(self) -> float:
        """s without targets after which the stream has ended."""
        return self._watchdog.timeout

    def heard(self) -> None:
        """A target came, or targets that wait were not looked at meanwhile."""
        self._watchdog.feed()

    def not_served(self) -> None:
        """After a long answer: what came meanwhile has not been seen yet."""
        if self._watchdog.fed:
            self._watchdog.feed()

    def forget(self) -> None:
        """Nothing is expected until the next target."""
        self._watchdog.clear()

    def period(self, came: bool, missed: float, moving: bool) -> None:
        """A period of the clock with a new pair or without, after ``missed`` s in which the machine made no tick.

        Targets of that time may not have been received yet, so it does not count: that time, and no more, because a
        machine that is late all the time would else never notice that nobody sends anything.
        """
        self._watchdog.excuse(missed)
        self.following |= came
        self._dry = 0 if came else self._dry + 1
        # two free-running clocks leave single ticks without a pair; more of them in motion is a gap
        self.lost += int(self.following and self._dry > LARGEST_DRY and moving)

    def ended(self) -> bool:
        """True when targets were followed and none came for :attr:`timeout`."""
        return self.following and self._watchdog.expired()
