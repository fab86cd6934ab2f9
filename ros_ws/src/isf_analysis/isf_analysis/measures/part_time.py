"""The time of a part, counted from its beginning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from isf_core.contour import ContourResult
from isf_core.types import Array

from isf_analysis.measures.record import PartRecord


def from_beginning(record: PartRecord, went_on: Sequence[int] = ()) -> PartRecord:
    """The ``record`` with all its times counted from the start of its first contour.

    By the clock they are s since 1970, and of a later part in a cell that stayed up s since the cell came up: neither
    is what a person reads as the time of a part. What happened before the first contour has a time below zero.

    ``went_on``: contours with which a part went on whose time had run on meanwhile. From the end of the contour before,
    nobody formed it: that is left out.
    """
    if not record.results:
        return record
    gaps = [gap for index in went_on if (gap := _gap(record.results, index)) is not None]
    began = record.results[0].start
    if began == 0.0 and not gaps:
        return record
    counted = _counted(began, gaps)
    return replace(
        record,
        results=tuple(
            replace(
                result,
                start=float(counted(result.start)),
                end=float(counted(result.end)),
                tick_time=counted(result.tick_time),
            )
            for result in record.results
        ),
        events=tuple(replace(event, time=float(counted(event.time))) for event in record.events),
        scans=tuple(replace(scan, time=float(counted(scan.time))) for scan in record.scans),
    )


def _gap(results: Sequence[ContourResult], index: int) -> tuple[float, float] | None:
    """s, end of the last contour before ``index`` and start of the next one; None where nothing is between them."""
    end = max((result.end for result in results if result.index < index), default=np.inf)
    start = min((result.start for result in results if result.index >= index), default=-np.inf)
    return (end, start) if start > end else None


def _counted(began: float, gaps: Sequence[tuple[float, float]]) -> Callable[[float | Array], Array]:
    """Of a time by the clock the time of the part, s; within a gap it stands still."""

    def counted(time: float | Array) -> Array:
        left_out = sum((np.clip(np.subtract(time, end), 0.0, start - end) for end, start in gaps), np.float64(0.0))
        return np.asarray(np.subtract(time, began) - left_out)

    return counted
