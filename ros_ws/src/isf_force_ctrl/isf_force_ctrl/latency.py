"""Wall time from the newer wrench of a pair to the targets that answer it, as the node itself sees it."""

from __future__ import annotations

import time
from collections import deque

KEPT = 5000
"""Newest values that the percentile is made of."""


class LatencyMeter:
    """Latency of the newest tick and of many; s of wall time.

    It begins where the message is taken out of the middleware: the way through the middleware is not in it.
    """

    def __init__(self) -> None:
        self._wrench = float("nan")
        self._kept: deque[float] = deque(maxlen=KEPT)
        self.last = float("nan")
        """s, newest latency; NaN before the first."""

    def wrench(self) -> None:
        """A wrench has come."""
        self._wrench = time.monotonic()

    def targets(self) -> None:
        """The targets are out."""
        if self._wrench == self._wrench:
            self.last = time.monotonic() - self._wrench
            self._kept.append(self.last)

    def percentile(self, share: float) -> float:
        """s, latency that the ``share`` (0..1) of the newest ticks kept below; NaN when there were none."""
        kept = sorted(self._kept)
        return kept[min(len(kept) - 1, int(share * len(kept)))] if kept else float("nan")

    def values(self) -> dict[str, object]:
        """For ``/diagnostics``."""
        if not self._kept:
            return {}
        return {f"latency_p{100 * share:.0f}_ms": f"{1e3 * self.percentile(share):.3f}" for share in (0.5, 0.99)}
