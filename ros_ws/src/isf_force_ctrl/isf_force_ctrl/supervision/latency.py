"""Times of the control loop as the node itself sees them: latency, period, delay of ticks; kept as histograms.

A histogram costs the same few hundred nanoseconds for every value and no sorting when it is read, so that publishing
percentiles does not delay the ticks that they describe.
"""

from __future__ import annotations

import math
import time
from bisect import bisect_left
from itertools import accumulate

BINS_PER_FACTOR = 100
"""Bins for every factor of e: a percentile is at most one per cent above the true one."""

SHORTEST, LONGEST = 1e-6, 10.0
"""s, range of the bins; what is outside counts in the first or the last one."""

NAN = float("nan")

_COUNT = int(BINS_PER_FACTOR * math.log(LONGEST / SHORTEST)) + 1


class Durations:
    """Distribution of many durations in s, with bins of one per cent."""

    def __init__(self) -> None:
        self.count = 0
        self.largest = NAN
        """s; NaN before the first."""
        self._bins = [0] * _COUNT

    def add(self, duration: float) -> None:
        """Take note of ``duration`` s; negative ones count as nothing."""
        index = int(BINS_PER_FACTOR * math.log(duration / SHORTEST)) if duration > SHORTEST else 0
        self._bins[index if index < _COUNT else _COUNT - 1] += 1
        if not self.count or duration > self.largest:
            self.largest = duration
        self.count += 1

    def percentile(self, share: float) -> float:
        """s, that the ``share`` (0..1) of all durations kept below (upper edge of a bin); NaN when there were none."""
        return self._percentile(list(accumulate(self._bins)), share)

    def values(self, name: str) -> dict[str, object]:
        """Median, 99th percentile and largest value in ms for ``/diagnostics``; nothing when there were none."""
        if not self.count:
            return {}
        totals = list(accumulate(self._bins))
        known = {"p50": self._percentile(totals, 0.5), "p99": self._percentile(totals, 0.99), "max": self.largest}
        return {f"{name}_{key}_ms": f"{1e3 * value:.3f}" for key, value in known.items()}

    def _percentile(self, totals: list[int], share: float) -> float:
        if not self.count:
            return NAN
        index = bisect_left(totals, max(1.0, share * self.count))
        return min(SHORTEST * math.exp((index + 1) / BINS_PER_FACTOR), self.largest)


class LatencyMeter:
    """Wall time from the newer wrench of a pair to the targets that answer it, and from targets to targets; s.

    The latency begins where the message is taken out of the middleware and ends where the targets of both tools are
    handed to it: the way through the middleware is not in it.
    """

    def __init__(self) -> None:
        self._wrench = self._targets = NAN
        self._latency, self._period = Durations(), Durations()
        self.last = NAN
        """s, newest latency; NaN before the first."""

    def wrench(self) -> None:
        """A wrench has come."""
        self._wrench = time.monotonic()

    def targets(self) -> None:
        """The targets are out. A wrench that was answered once is not measured again."""
        now = time.monotonic()
        if self._targets == self._targets:
            self._period.add(now - self._targets)
        self._targets = now
        if self._wrench == self._wrench:
            self.last = now - self._wrench
            self._latency.add(self.last)
            self._wrench = NAN

    def values(self) -> dict[str, object]:
        """For ``/diagnostics``."""
        return self._latency.values("latency") | self._period.values("period")
