"""The newest targets of both tools, and of the blank holder where there is one, matched by their stamps."""

from __future__ import annotations

import threading
from dataclasses import dataclass

Tip = tuple[float, float, float]


@dataclass
class _Target:
    stamp: int = -1
    tip: Tip = (0.0, 0.0, 0.0)
    fresh: bool = False


class TargetPair:
    """Filled by the subscriptions, emptied by the tick (perhaps in another thread).

    Attributes
    ----------
    holder : m, height of the blank holder of the last pair taken
    received : pairs taken ; stamp : ns, of the last pair taken ; elapsed : ns, from the pair before to that one
    """

    def __init__(self) -> None:
        self.received = self.stamp = self.elapsed = 0
        self.holder = 0.0
        self._targets = (_Target(), _Target())
        self._holder = _Target()
        self._with_holder = False
        self._lock = threading.Lock()

    def put(self, tool: int, stamp: int, tip: Tip) -> None:
        """Target of ``tool`` (1 or 2) with its stamp in ns and tip m."""
        with self._lock:
            target = self._targets[tool - 1]
            target.stamp, target.tip, target.fresh = stamp, tip, True

    def expect_holder(self, expected: bool) -> None:
        """A pair is whole only with a target of the blank holder, or never mind it; the holder is at its start."""
        with self._lock:
            self._with_holder, self.holder = expected, 0.0

    def put_holder(self, stamp: int, height: float) -> None:
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
        """Forget targets that were not taken."""
        with self._lock:
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
            self.elapsed, self.stamp = (first.stamp - self.stamp if self.received else 0), first.stamp
            self.received += 1
            return first.tip, second.tip
