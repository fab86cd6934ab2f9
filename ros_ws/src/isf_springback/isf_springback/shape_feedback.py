"""Shape feedback: which methods look at scans, and when a scan is due.

A method that uses the formed shape has the three functions of :class:`CorrectionMethod` and those of
:class:`ShapeFeedback`. Per contour the order is::

    method.learn(corrected, result)     # forces of contour k
    method.see(points, k)               # scan after contour k, when one is due and came
    method.correct(contour k + 1)
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array


@runtime_checkable
class ShapeFeedback(Protocol):
    """A correction method that looks at the formed shape."""

    def take_target(self, target: HeightMap) -> None:
        """The shape that is wanted, before the first contour; never raises."""
        ...

    def see(self, points: Array, index: int) -> None:
        """Points (P, 3) m of the sheet's upper surface after contour ``index``; never raises."""
        ...


def scan_due(job_file: JobFile, index: int, count: int) -> bool:
    """True when the shape is measured between contour ``index`` (0-based) and the next one of ``count``."""
    every = job_file.job.springback.scan_every
    return every > 0 and (index + 1) % every == 0 and index + 1 < count


def scan_awaited(job_file: JobFile, index: int) -> bool:
    """True when contour ``index`` is corrected from a scan made just before it."""
    return index > 0 and scan_due(job_file, index - 1, index + 1)
