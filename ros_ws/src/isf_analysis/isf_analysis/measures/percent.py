"""Shares as people read them: one number, wherever it is shown."""

from __future__ import annotations

import math


def in_percent(fraction: float, digits: int = 2) -> float:
    """``fraction`` in percent, rounded down: a share that falls short never reads as the wanted one."""
    scale = 10**digits
    return math.floor(100 * scale * fraction + 1e-6) / scale  # 0.29 is 28.999... in binary


def percent(fraction: float, digits: int = 2) -> str:
    """Text of :func:`in_percent`."""
    shown = in_percent(fraction, digits)
    return "100 %" if shown == 100.0 else f"{shown:.{digits}f} %"
