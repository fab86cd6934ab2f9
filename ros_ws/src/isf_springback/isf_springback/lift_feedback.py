"""Tool lifting between contours: what a lift measures, and how it scales the springback of a model.

The forming tool lifts off the sheet while height and force are recorded; the way until the force vanishes is the
springback at that place (Ren 2018, 4.2.2). At a measured place ``S_true(F) = S_law(F) e^a (F / F_0)^b`` with F_0 the
force before lifting. ``a`` and ``b`` are estimated over the part as two Gaussian processes: a share common to the whole
part (sheet thickness, modulus, edge) and a share of the region (shape of the part around the place), which fades with
the distance from the measured places. Every estimate comes with its standard deviation; without a measurement
a = b = 0.
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


COMMON_DEVIATION = 0.20
"""Standard deviation of a, common to the part (assumed: 5 % of thickness alone change bending by 15 %)."""
REGION_DEVIATION = 0.07
"""Standard deviation of a from region to region (published differences of simulated and scanned parts: 3.4 to 10.6 %,
Ren 2018, 4.2.3)."""
REGION_SIZE = (30e-3, 10e-3)
"""m in plan and in depth, over which a region is alike (assumed)."""
READING_DEVIATION = 0.15e-3
"""m, standard deviation of a lift (published: less than 0.3 mm against a dial gauge, Ren 2018, 4.2.2)."""
EXPONENT_DEVIATION = 0.15
"""Standard deviation of b before a measurement (assumed: exponents lie between 1/3, membrane, and 1, plate)."""
EXPONENT_READING = 0.05
"""Standard deviation of b from one curve (assumed)."""
LARGEST_SCALE = 2.0
"""The measured law stays within this factor of the computed one (assumed)."""
_FORCE_RANGE = 2.0
_MAXIMUM_READINGS = 100


@dataclass(frozen=True)
class _Reading:
    place: Array
    level: float
    exponent: float
    force: float
    noise: float


@dataclass(frozen=True)
class Scale:
    """Factor (M,) on the displacement of a law, and its standard deviation (M,) as a part of it; ``measured``: from
    lifts."""

    factor: Array
    deviation: Array
    measured: bool = True


class LawScale:
    """State: the readings of the part in hand."""

    def __init__(self) -> None:
        self._readings: list[_Reading] = []

    def __len__(self) -> int:
        return len(self._readings)

    def clear(self) -> None:
        """A new part begins."""
        self._readings = []

    def add(self, place: Array, reading: LiftReading, law: Array) -> None:
        """Compare ``reading`` with ``law`` (K,) m, the displacements that the unscaled law gives for its forces at the
        contact ``place`` (3,) m."""
        usable = np.isfinite(law) & (law > 0.0)
        if usable.sum() < 2:
            return
        force, ratio = reading.force[usable], np.log(reading.displacement[usable] / law[usable])
        steps = np.log(force / force[0])
        if np.ptp(steps) < 0.1:
            exponent, level = 0.0, float(ratio.mean())
        else:
            exponent, level = (float(value) for value in np.polyfit(steps, ratio, 1))
        noise = READING_DEVIATION / reading.springback
        made = _Reading(np.array(place), level, exponent, float(force[0]), noise)
        self._readings = [*self._readings[-_MAXIMUM_READINGS + 1 :], made]

    def at(self, place: Array, force: Array) -> Scale:
        """Scale at ``place`` (M, 3) m under ``force`` (M,) N; before a reading 1 with the deviation of not knowing."""
        prior = COMMON_DEVIATION**2 + REGION_DEVIATION**2
        if not self._readings:
            return Scale(np.ones(len(place)), np.full(len(place), np.sqrt(prior)), measured=False)
        known = np.array([reading.place for reading in self._readings])
        latest = self._readings[-1].force
        steps = np.array([np.log(latest / reading.force) for reading in self._readings])
        exponents = np.array([reading.exponent for reading in self._readings])
        levels = np.array([reading.level for reading in self._readings]) + exponents * steps
        noise = np.array([reading.noise for reading in self._readings]) ** 2 + (EXPONENT_READING * steps) ** 2
        among, towards = _covariance(known, known), _covariance(place, known)
        gain = np.linalg.solve(among + np.diag(noise), towards.T).T
        level = gain @ levels
        variance = np.maximum(prior - (gain * towards).sum(axis=1), 0.0)
        share = EXPONENT_DEVIATION**2 / (EXPONENT_DEVIATION**2 + EXPONENT_READING**2 / len(levels))
        way = np.clip(np.log(np.maximum(force, 1e-9) / latest), -np.log(_FORCE_RANGE), np.log(_FORCE_RANGE))
        most = np.log(LARGEST_SCALE)
        return Scale(np.exp(np.clip(level + share * exponents.mean() * way, -most, most)), np.sqrt(variance))

    def remark(self) -> str:
        """What a person should know: the scale at the newest place; "" before a reading or when the law holds."""
        if not self._readings:
            return ""
        newest = self._readings[-1]
        scale = self.at(newest.place[None], np.array([newest.force]))
        if abs(float(scale.factor[0]) - 1.0) < 2.0 * float(scale.deviation[0]):
            return ""
        return (
            f"tool lifting: the sheet springs back {scale.factor[0]:.2f} times what the model says "
            f"(standard deviation {scale.deviation[0]:.2f}); the model follows"
        )


def _covariance(place: Array, other: Array) -> Array:
    """(M, K) covariance of a at ``place`` (M, 3) and ``other`` (K, 3) m."""
    plan = ((place[:, None, :2] - other[None, :, :2]) ** 2).sum(axis=2) / REGION_SIZE[0] ** 2
    depth = (place[:, None, 2] - other[None, :, 2]) ** 2 / REGION_SIZE[1] ** 2
    return np.asarray(COMMON_DEVIATION**2 + REGION_DEVIATION**2 * np.exp(-0.5 * (plan + depth)))
