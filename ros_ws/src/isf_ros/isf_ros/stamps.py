"""Times of control ticks as exact integer nanoseconds, so that stamps can be compared for equality."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time

NANO = 1_000_000_000


def tick_nanoseconds(tick: int, rate: float) -> int:
    """Time of control tick ``tick`` at ``rate`` (Hz), ns, rounded once and never accumulated."""
    return round(tick * NANO / rate)


def to_stamp(nanoseconds: int) -> Time:
    """Message stamp of a time in ns."""
    seconds, rest = divmod(int(nanoseconds), NANO)
    return Time(sec=seconds, nanosec=rest)


def to_nanoseconds(stamp: Any) -> int:
    """Time in ns of a message stamp (any object with ``sec`` and ``nanosec``)."""
    return int(stamp.sec) * NANO + int(stamp.nanosec)


def from_seconds(seconds: float) -> Time:
    """Message stamp of a time in s."""
    return to_stamp(round(seconds * NANO))


def to_seconds(stamp: Any) -> float:
    """Time in s of a message stamp."""
    return to_nanoseconds(stamp) / NANO
