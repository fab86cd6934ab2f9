"""The newest targets of both tools, matched by their stamps."""

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
    received : pairs taken ; stamp : ns, of the last pair taken ; elapsed : ns, from the pair before to that one
    """

    def __init__(self) -> None:
        self.received = self.stamp = self.elapsed = 0
        self._targets = (_Target(), _Target())
        self._lock = threading.Lock()

    def put(self, tool: int, stamp: int, tip: Tip) -> None:
        """Target of ``tool`` (1 or 2) with its stamp in ns and tip m."""
        with self._lock:
            target = self._targets[tool - 1]
            target.stamp, target.tip, target.fresh = stamp, tip, True

    def take_at(self, stamp: int) -> tuple[Tip, Tip] | None:
        """Both tips when both targets carry exactly ``stamp`` ns (lockstep), else None."""
        return self._take(stamp)

    def take_newest(self) -> tuple[Tip, Tip] | None:
        """Both tips when both came since the last pair was taken (real time), else None."""
        return self._take(None)

    def clear(self) -> None:
        """Forget targets that were not taken."""
        with self._lock:
            for target in self._targets:
                target.fresh = False

    def _take(self, stamp: int | None) -> tuple[Tip, Tip] | None:
        first, second = self._targets
        with self._lock:
            if not (first.fresh and second.fresh):
                return None
            if stamp is not None and not first.stamp == second.stamp == stamp:
                return None
            first.fresh = second.fresh = False
            self.elapsed, self.stamp = (first.stamp - self.stamp if self.received else 0), first.stamp
            self.received += 1
            return first.tip, second.tip
