"""Error of wall and base that the correction expects of itself, before the finished part is measured.

Every correction tells, at the points of its contour, the error that will remain and the standard deviation of what it
predicted; on top comes what parts of one condition differ by. A place of the target has those of the contour point
nearest in plan. What a scan between contours has seen is known better: the last one stands for its places, and the
movement from the scan before, carried on over the contours that were left, for its standard deviation; where there was
one scan, that is as without it. Places that it saw for the first time tell how far what the corrections expected was
off: no better known are the places formed after it.

Errors are taken to be alike all over the part (assumed: thickness, modulus and edge of a sheet are), so that the error
at a place is ``left + deviation z`` with one standard normal ``z`` for all. Expected are the means over z of the
largest and of the mean size. Nothing of the finished part's own scan goes into them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import contour_label
from isf_core.errors import IsfError
from isf_core.files.job import lift_interval
from isf_core.types import Array
from scipy.spatial import cKDTree
from scipy.special import ndtri

from isf_analysis.measures.contour_scan import ScanError
from isf_analysis.measures.deviation import regions_of
from isf_analysis.measures.record import PartRecord

OVERCONFIDENT = 1.5
"""Reached over expected largest error above which a part counts as overconfident (assumed)."""

REPEATABILITY = 0.2e-3
"""m, standard deviation of the shape of parts of one condition (measured: repeats of a cone differ by 0.3 mm, so that
each is off by this; benchmarks/data/spif_cones_measured.csv)."""

FORESEEN = 0.1e-3
"""m of error foreseen at the first contour, from which it is named."""

FEWEST_KNOWN = 0.9
"""Share of wall and base of which something has to be known (assumed)."""

_NORMAL = ndtri((np.arange(50) + 0.5) / 50)
"""A standard normal, by quantiles."""


@dataclass(frozen=True)
class ExpectedError:
    """Expected error of wall and base, m; NaN: not known.

    Attributes
    ----------
    largest, mean : of its size, vertical
    stands_on : for people: what it stands on, or why it is not known
    """

    largest: float
    mean: float
    stands_on: str

    @property
    def known(self) -> bool:
        """False: the correction cannot tell."""
        return bool(np.isfinite(self.largest))


def expected_error(record: PartRecord, scans: Sequence[ScanError] = ()) -> ExpectedError:
    """Of the part in ``record``, from its corrections and the errors after its ``scans`` between contours."""
    if not record.corrects:
        return _unknown("springback is not corrected")
    if record.target is None:
        return _unknown("the wanted shape is not recorded")
    try:
        wanted = regions_of(record.target)["wall_and_base"]
    except IsfError as error:
        return _unknown(error.what)
    last = record.last_stage[-1].index if record.last_stage else -1
    seen = [scan for scan in scans if scan.stage == record.last_stage[-1].stage and scan.index < last]
    left, deviation = _by_corrections(record, record.target.points()[:, :2][wanted.ravel()])
    told = bool((np.isfinite(left) & np.isfinite(deviation)).any())
    if seen:
        left, deviation = _with_scans(left, deviation, [(scan.index, scan.error.z[wanted]) for scan in seen], last)
    known = np.isfinite(left) & np.isfinite(deviation)
    if not known.any() or known.mean() < FEWEST_KNOWN:
        return _unknown(f"the method {record.correction} does not tell how uncertain it is")
    largest, mean = sizes(left[known], deviation[known])
    return ExpectedError(largest, mean, _stands_on(record, told, seen[-1].index if seen else None))


def sizes(left: Array, deviation: Array) -> tuple[float, float]:
    """m, expected largest and mean size of ``left + deviation z``, (N,) m each, over a standard normal z.

    NaN of no place.
    """
    if not len(left):
        return float("nan"), float("nan")
    size = np.abs(left[:, None] + deviation[:, None] * _NORMAL)
    return float(size.max(axis=0).mean()), float(size.mean())


def known_deviation(uncertainty: Array, points: int) -> Array:
    """(points,) m, standard deviation of what a correction leaves, by the ``uncertainty`` of its prediction; NaN where
    that is not told: without a force, of a springback that is taken for 0, none is known."""
    if len(uncertainty) != points:
        return np.full(points, np.nan)
    return np.where(uncertainty > 0.0, np.hypot(uncertainty, REPEATABILITY), np.nan)


def overconfident(expected: float | None, reached: float | None) -> bool | None:
    """Whether the largest error ``reached`` is more than 1.5 times the one ``expected``, in one unit; None: one of them
    is not known."""
    ratio = reached_over_expected(expected, reached)
    return None if ratio is None else ratio > OVERCONFIDENT


def reached_over_expected(expected: float | None, reached: float | None) -> float | None:
    """``reached`` over ``expected`` in one unit; None where one of them is not known."""
    return reached / expected if expected and reached is not None else None


def _unknown(why: str) -> ExpectedError:
    return ExpectedError(float("nan"), float("nan"), why)


def _by_corrections(record: PartRecord, places: Array) -> tuple[Array, Array]:
    """(M,) m, error left and its standard deviation at ``places`` (M, 2) m, of the nearest contour point; NaN: not
    known."""
    corrections = {item.index: item for item in record.corrections}
    contours = [contour for contour in record.last_stage if contour.index in corrections]
    if not contours:
        return np.full(len(places), np.nan), np.full(len(places), np.nan)
    left, deviation = [], []
    for contour in contours:
        item, points = corrections[contour.index], len(contour)
        told = item.residual if len(item.residual) == points else np.full(points, np.nan)
        left.append(told)
        deviation.append(known_deviation(item.uncertainty, points))
    _, nearest = cKDTree(np.concatenate([contour.contact[:, :2] for contour in contours])).query(places)
    return np.concatenate(left)[nearest], np.concatenate(deviation)[nearest]


def _with_scans(left: Array, deviation: Array, seen: Sequence[tuple[int, Array]], last: int) -> tuple[Array, Array]:
    """``left`` and ``deviation`` (M,) m after the errors (M,) m that were ``seen`` after contours, NaN where not;
    contour ``last`` ends the part."""
    index, now = seen[-1]
    before_index, before = seen[-2] if len(seen) > 1 else (index, np.full(len(now), np.nan))
    here, then = np.isfinite(now), np.isfinite(before)
    new = here & ~then if (here & ~then).any() else here
    off = _rms(now[new] - left[new])
    moved = _rms((now - before)[here & then]) / max(index - before_index, 1)
    # of one scan it is not known what moves on: as much as was expected without it
    moving = np.fmax(deviation, REPEATABILITY) if np.isnan(moved) else np.hypot(moved * (last - index), REPEATABILITY)
    return np.where(here, now, left), np.where(here, moving, np.fmax(deviation, off))


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def _stands_on(record: PartRecord, told: bool, scanned: int | None) -> str:
    by = "parts formed before, real or tried (springback.learning)" if record.correction == "learned" else ""
    parts = [by or f"the standard deviation that {record.correction} gives"] if told else []
    first = record.last_stage[0].index if record.last_stage else -1
    foreseen = next((item.residual for item in record.corrections if item.index == first), np.empty(0))
    if told and not by and np.isfinite(foreseen).any() and abs(np.nanmean(foreseen)) > FORESEEN:
        parts.append(f"{1e3 * abs(np.nanmean(foreseen)):.1f} mm that it foresees at the opening")
    try:
        every = lift_interval(record.job(), record.correction)
    except IsfError:  # of another version
        every = 0
    if every and told:
        parts.append("tool lifts every contour" if every == 1 else f"tool lifts every {every} contours")
    if scanned is not None:
        parts.append(f"the scan after {contour_label(scanned)} of {record.planned}")
    return ", ".join(parts)
