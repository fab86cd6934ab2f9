"""Tool lifting between contours: when one is due, what it tells, and which methods learn from it.

The forming tool lifts off the sheet while height and force are recorded; the way until the force vanishes is the
springback at that place (Ren 2018, 4.2.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.files.job import JobFile
from isf_core.types import Array

USED_FROM = 0.3
"""Part of the force before lifting above which the curve is compared with a law (assumed: below, the contact patch
shrinks, and the way of the ball into the sheet counts)."""

_FEWEST = 4
_KEPT = 40
_LARGEST_SPRINGBACK = 30e-3


@dataclass(frozen=True)
class LiftReading:
    """One unloading at one place.

    Attributes
    ----------
    place : (3,) m, tip of the loaded forming tool
    force : (K,) N, axial force, from the largest down, all above :data:`USED_FROM` of it
    displacement : (K,) m, elastic displacement of the sheet under ``force``; 0 where the force vanishes
    """

    place: Array
    force: Array
    displacement: Array

    @property
    def springback(self) -> float:
        """m, displacement under the largest force."""
        return float(self.displacement[0])


def reading_of(rows: Array) -> LiftReading | None:
    """The reading in ``rows`` (K, 4): x, y, z of the tip in m and the axial force in N; None when they tell nothing.

    The first row is the loaded tool at rest, the last one the place where the force vanishes (0 N); in between the
    unloading curve in its order. No rows: the measurement failed.
    """
    table = np.asarray(rows, dtype=np.float64)
    if table.ndim != 2 or table.shape[1:] != (4,) or len(table) < _FEWEST or not np.isfinite(table).all():
        return None
    force, displacement = np.abs(table[:, 3]), np.abs(table[-1, 2] - table[:, 2])
    used = force >= USED_FROM * force[0]
    used[-1] = False
    if not 0.0 < displacement[0] < _LARGEST_SPRINGBACK or force[0] <= 0.0 or used.sum() < _FEWEST:
        return None
    kept = np.flatnonzero(used)[np.unique(np.linspace(0, used.sum() - 1, _KEPT).round().astype(np.int64))]
    return LiftReading(table[0, :3].copy(), force[kept], np.maximum(displacement[kept], 1e-6))


def lift_due(job_file: JobFile, index: int, count: int) -> bool:
    """True when the tool is lifted between contour ``index`` (0-based) and the next one of ``count``."""
    every = job_file.job.springback.lift_every
    return every > 0 and (index + 1) % every == 0 and index + 1 < count


def lift_awaited(job_file: JobFile, index: int) -> bool:
    """True when contour ``index`` is corrected after a lift made just before it."""
    return index > 0 and lift_due(job_file, index - 1, index + 1)
