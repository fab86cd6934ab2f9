"""The newest targets of both tools and of the blank holder, matched by their stamps, and whether they still come.

Tells whose fault it is when they do not. Stamps in s, poses in frame ``sheet``.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from isf_core.geometry.tool_axis import UPRIGHT
from isf_ros.watchdog import ReceiveWatchdog

Tip = tuple[float, float, float]


@dataclass
class _Target:
    stamp: int = -1
    tip: Tip = (0.0, 0.0, 0.0)
    fresh: bool = False
    axis: Tip = UPRIGHT


class TargetPair:
    """Filled by the subscriptions, emptied by the tick (perhaps in another thread).

    Attributes
    ----------
    holder : m, height of the blank holder, and axis (3,) of tool 1, of the last pair taken
    received : pairs taken ; stamp : ns, of the last pair taken ; elapsed : ns, from the pair before to that one; 0
        for the first pair and for the first after :meth:`clear`, which begin a stream and are not late
    """

    def __init__(self) -> None:
        self.received = self.stamp = self.elapsed = 0
        self.holder = 0.0
        self.axis: Tip = UPRIGHT
        self._targets = (_Target(), _Target())
        self._holder = _Target()
        self._with_holder = False
        self._anew = True
        self._lock = threading.Lock()

    def add(self, tool: int, stamp: int, tip: Tip, axis: Tip = UPRIGHT) -> None:
        """Target of ``tool`` (1 or 2) with its stamp in ns, tip m and axis."""
        with self._lock:
            target = self._targets[tool - 1]
            target.stamp, target.tip, target.axis, target.fresh = stamp, tip, axis, True

    def expect_holder(self, expected: bool) -> None:
        """A pair is whole only with a target of the blank holder, or never mind it; the holder is at its start."""
        with self._lock:
            self._with_holder, self.holder = expected, 0.0

    def add_holder(self, stamp: int, height: float) -> None:
        """Target of the blank holder with its stamp in ns and height m."""
        with self._lock:
            self._holder.stamp, self._holder.tip, self._holder.fresh = stamp, (0.0, 0.0, height), True

    def take_at(self, stamp: int) -> tuple[Tip, Tip] | None:
        """Both tips when both targets carry exactly ``stamp`` ns (lockstep), else None."""
        return self._take(stamp)

    def take_newest(self) -> tuple[Tip, Tip] | None:
        """Both tips when both came since the last pair was taken (real time), else None."""
        return self._take(None)

    def clear(self) -> None:
        """Forget targets that were not taken, and when the last ones were."""
        with self._lock:
            self._anew = True
            for target in (*self._targets, self._holder):
                target.fresh = False

    def _take(self, stamp: int | None) -> tuple[Tip, Tip] | None:
        first, second = self._targets
        with self._lock:
            needed = (first, second, self._holder) if self._with_holder else (first, second)
            if not all(target.fresh for target in needed):
                return None
            if stamp is not None and any(target.stamp != stamp for target in needed):
                return None
            for target in needed:
                target.fresh = False
            self.holder = self._holder.tip[2] if self._with_holder else 0.0
            self.axis = first.axis
            self.elapsed, self.stamp = (0 if self._anew else first.stamp - self.stamp), first.stamp
            self._anew = False
            self.received += 1
            return first.tip, second.tip


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
