"""Tool lifting between contours: what a lift measures, and how it scales the springback of a model.

The forming tool lifts off the sheet while height and force are recorded; the way until the force vanishes is the
springback at that place (Ren 2018, 4.2.2). At a measured place it is ``S_true(F) = f S_law(F)``, with f from how the
way changes with the force: while the last of it fades, the ball also leaves the dent that it stands in, and the wall
beside it, which is a way without springback (on the elasto-plastic sheet 0.5 of 1.1 mm over a backing plate).

Elsewhere, and at other forces, ``S_true = (1 + a) S_law + m``: a by what the law takes for granted (thickness, modulus,
edge), m by what it does not know of, the springback of what is bent around the tool. They are estimated over the part
as Gaussian processes: m and a share of a are common to the whole part, another share of a is that of the region (shape
of the part around the place) and fades with the distance from the measured places. Every estimate comes with its
standard deviation; without a measurement a = m = 0. Where readings lay farther from what was expected of them than
that, it is raised by as much (ratio of Birge 1932): the law then lacks more than a and m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.files.job import JobFile, lift_interval
from isf_core.types import Array

USED_FROM = 0.3
"""Part of the force before lifting above which the curve is compared with a law (assumed: below, the contact patch
shrinks, and the way of the ball into the sheet counts)."""

NOTHING = 1e-9
"""m, a law that says no more is not compared."""

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


def lift_due(job_file: JobFile, index: int, count: int, method: str) -> bool:
    """True when a run with ``method`` lifts the tool between contour ``index`` (0-based) and the next of ``count``.

    After the first one too: the contours at the opening are what nothing mends later.
    """
    every = lift_interval(job_file.job, method)
    return every > 0 and (index == 0 or (index + 1) % every == 0) and index + 1 < count


def lift_awaited(job_file: JobFile, index: int, method: str) -> bool:
    """True when a run with ``method`` corrects contour ``index`` after a lift made just before it."""
    return index > 0 and lift_due(job_file, index - 1, index + 1, method)


COMMON_DEVIATION = 0.20
"""Standard deviation of a, common to the part (assumed: 5 % of thickness alone change bending by 15 %)."""
REGION_DEVIATION = 0.07
"""Standard deviation of a from region to region (published differences of simulated and scanned parts: 3.4 to 10.6 %,
Ren 2018, 4.2.3)."""
REGION_SIZE = (30e-3, 10e-3)
"""m in plan and in depth, over which a region is alike (assumed)."""
MISSING_DEVIATION = 0.3e-3
"""m, standard deviation of m (assumed). Where a plate close to the opening leaves a law of 0.1 mm, m is most of all."""
READING_DEVIATION = 0.15e-3
"""m, standard deviation of a lift (published: less than 0.3 mm against a dial gauge, Ren 2018, 4.2.2)."""
LARGEST_DENT = 0.6e-3
"""m, most of a way without springback (assumed: as deep is the hollow of a ball of 5 mm that touches a circle of 2.4 mm
radius). More of it comes from a sheet whose last bending is softer than the law says."""
DENT, DENT_DEVIATION = 0.3e-3, 0.17e-3
"""m, a way without springback before its curve is seen, and its standard deviation (assumed: anything from none to the
most). The curve of an unbacked sheet, half of whose springback is left at the least force, hardly tells it from the
law: a line alone calls a dent of 0.2 mm in 5.5 mm none, and the law 4 % too small."""
CURVE_DEVIATION = 0.05e-3
"""m, of the halves of a curve from the law's shape (assumed; 0.02 to 0.06 mm are left by a fit on both sheets)."""
LARGEST_SCALE, LARGEST_MISSING = 2.0, 3.0 * MISSING_DEVIATION
"""The estimate is between half and twice what the law says, or above it by so many m (assumed)."""
_MAXIMUM_READINGS = 100


@dataclass(frozen=True)
class _Reading:
    """m, what the ``law`` says under the load of forming, and what is ``found``; ``surprise``: by how many standard
    deviations of what was expected before it."""

    place: Array
    law: float
    found: float
    surprise: float


@dataclass(frozen=True)
class Lifted:
    """Springback (M,) m and its standard deviation (M,) m."""

    springback: Array
    deviation: Array


class LiftedLaw:
    """A law as the tool lifts of the part in hand say it is. State: their readings."""

    def __init__(self) -> None:
        self._readings: list[_Reading] = []

    def clear(self) -> None:
        """A new part begins."""
        self._readings = []

    def add(self, place: Array, reading: LiftReading, law: Array, said: float | None = None) -> None:
        """Compare ``reading`` with ``law`` (K,) m, the displacements that the law gives for its forces at the contact
        ``place`` (3,) m.

        ``said`` m, what the law says of this place under the load measured while the contour was formed, with which it
        is asked for the coming ones; None: what it says under the largest force of the reading. The two loads differ
        where the support tool stands beside the contact: 140 N while both tools hold the sheet, 90 N once the forming
        tool holds it alone in the same place.
        """
        usable = np.isfinite(law) & (law > NOTHING)
        if usable.sum() < 2:
            return
        law, displacement = law[usable], reading.displacement[usable]
        factor, dent = _factor_and_dent(law, displacement)
        if not 0.0 <= dent <= LARGEST_DENT:
            dent = min(max(dent, 0.0), LARGEST_DENT)
            factor = float(law @ (displacement - dent) / (law @ law))
        found = factor * float(law[0])
        says = said if said is not None and said > NOTHING else float(law[0])
        expected = self.at(np.array(place)[None], np.array([says]))
        # against what was expected before surprises widened it: else each would count for less than the one before
        doubt = float(np.hypot(expected.deviation[0] / self.spread, READING_DEVIATION))
        made = _Reading(np.array(place), says, found, (found - float(expected.springback[0])) / doubt)
        self._readings = [*self._readings[-_MAXIMUM_READINGS + 1 :], made]

    def at(self, place: Array, law: Array) -> Lifted:
        """Springback at ``place`` (M, 3) m where the law says ``law`` (M,) m; before a reading just that."""
        prior = COMMON_DEVIATION**2 + REGION_DEVIATION**2
        if not self._readings:
            missing = np.where(law > 0.0, MISSING_DEVIATION, 0.0)
            return Lifted(law, np.sqrt(prior * law**2 + missing**2))
        known = np.array([reading.place for reading in self._readings])
        said, found = np.array([(reading.law, reading.found) for reading in self._readings]).T
        share = np.clip(law / said[-1], 0.0, 1.0)  # without a force nothing springs back
        missing = MISSING_DEVIATION * share
        among = np.outer(said, said) * _covariance(known, known) + MISSING_DEVIATION**2
        towards = np.outer(law, said) * _covariance(place, known) + MISSING_DEVIATION * missing[:, None]
        gain = np.linalg.solve(among + READING_DEVIATION**2 * np.eye(len(said)), towards.T).T
        variance = prior * law**2 + missing**2 - (gain * towards).sum(axis=1)
        most = np.maximum(LARGEST_SCALE * law, law + LARGEST_MISSING * share)
        estimate = np.clip(law + gain @ (found - said), law / LARGEST_SCALE, most)
        return Lifted(estimate, self.spread * np.sqrt(np.maximum(variance, 0.0)))

    @property
    def spread(self) -> float:
        """How far the readings lay from what was expected of them, in its standard deviations (root mean square); 1
        where they lay nearer, or before one."""
        surprise = [reading.surprise for reading in self._readings]
        return max(1.0, float(np.sqrt(np.mean(np.square(surprise))))) if surprise else 1.0

    def share_at(self, place: Array) -> Array:
        """(M,) springback at ``place`` (M, 3) m over what the law says, where that is what it said at the newest
        reading; 1 before one."""
        law = np.full(len(place), self._readings[-1].law if self._readings else 1.0)
        return self.at(place, law).springback / law

    def remark(self) -> str:
        """What a person should know: springback at the newest place; "" before a reading or when the law holds."""
        if not self._readings:
            return ""
        newest = self._readings[-1]
        lifted = self.at(newest.place[None], np.array([newest.law]))
        springback, deviation = float(lifted.springback[0]), float(lifted.deviation[0])
        if abs(springback - newest.law) < 2.0 * deviation:
            return ""
        return (
            f"tool lifting: the sheet springs back {1e3 * springback:.2f} mm (standard deviation "
            f"{1e3 * deviation:.2f} mm) where the model says {1e3 * newest.law:.2f} mm; the correction follows"
        )


def _factor_and_dent(law: Array, way: Array) -> tuple[float, float]:
    """f and dent, m, most likely with ``way = f law + dent`` (K,) m each, given what dents are like."""
    seen = 2.0 / len(law) / CURVE_DEVIATION**2  # the points of one half err together
    normal = seen * np.array([[law @ law, law.sum()], [law.sum(), len(law)]])
    normal[1, 1] += 1.0 / DENT_DEVIATION**2
    right = np.array([seen * (law @ way), seen * way.sum() + DENT / DENT_DEVIATION**2])
    factor, dent = np.linalg.solve(normal, right)
    return float(factor), float(dent)


def _covariance(place: Array, other: Array) -> Array:
    """(M, K) covariance of a at ``place`` (M, 3) and ``other`` (K, 3) m."""
    plan = ((place[:, None, :2] - other[None, :, :2]) ** 2).sum(axis=2) / REGION_SIZE[0] ** 2
    depth = (place[:, None, 2] - other[None, :, 2]) ** 2 / REGION_SIZE[1] ** 2
    return np.asarray(COMMON_DEVIATION**2 + REGION_DEVIATION**2 * np.exp(-0.5 * (plan + depth)))
