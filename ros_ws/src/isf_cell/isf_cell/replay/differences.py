"""Two records of the same contours set beside each other, number by number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from isf_core.contour import ContourCorrection, ContourResult

NOT_DECIDED = ("forming_measured", "support_measured", "late_ticks", "lost_messages", "solve_time", "message")
"""Fields that tell of machine, network or computer and not of a decision."""

NANOSECOND = 2e-9
"""s, what the times of a message are rounded by."""


@dataclass(frozen=True)
class Difference:
    """Of two lists of contours.

    Attributes
    ----------
    compared : contours that are in both
    differing : names of the fields that are not the same to the last bit, with their largest difference in SI units
    first : contour of the first difference, None: there is none
    missing : contours that are in one alone
    """

    compared: int
    differing: dict[str, float]
    first: int | None
    missing: int

    @property
    def identical(self) -> bool:
        """True when nothing differs."""
        return not self.differing and not self.missing


def difference(
    recorded: Sequence[ContourResult] | Sequence[ContourCorrection],
    again: Sequence[ContourResult] | Sequence[ContourCorrection],
) -> Difference:
    """Of results, or of corrections, by contour."""
    before = {item.index: item for item in recorded}
    after = {item.index: item for item in again}
    differing: dict[str, float] = {}
    first: int | None = None
    for index in sorted(before.keys() & after.keys()):
        for item in fields(before[index]):
            if item.name in NOT_DECIDED:
                continue
            size = _size(item.name, getattr(before[index], item.name), getattr(after[index], item.name))
            if size is not None:
                differing[item.name] = max(size, differing.get(item.name, 0.0))
                first = index if first is None else first
    return Difference(len(before.keys() & after.keys()), differing, first, len(before.keys() ^ after.keys()))


def _size(name: str, one: Any, other: Any) -> float | None:
    """Largest difference of two values of a field, None when they are the same; infinite for other sizes or words."""
    if isinstance(one, np.ndarray):
        if one.shape != np.shape(other):
            return float("inf")
        before, after = one.astype(float), np.asarray(other, dtype=float)
        if not np.array_equal(np.isnan(before), np.isnan(after)):
            return float("inf")
        if np.array_equal(before, after, equal_nan=True):
            return None
        with np.errstate(invalid="ignore"):
            return float(np.nanmax(np.abs(before - after), initial=0.0))
    if name in ("start", "end"):
        return None if abs(one - other) <= NANOSECOND else abs(one - other)
    if one == other or (one != one and other != other):
        return None
    return abs(float(one) - float(other)) if isinstance(one, int | float) else float("inf")
