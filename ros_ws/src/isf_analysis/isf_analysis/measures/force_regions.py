"""Where along the contours the support force was off, and where the support tool lost the sheet.

Everything comes from the results of the contours, so it works from a bag as it does in one process. The force is that
at the contour points: F_n = d_n . F_support, d_n the horizontal unit vector from the forming to the support tool
(Ren 2018 eq. 2-2, 2-3), here from the streamed tips. Points are a sample of the ticks (one in eight at 0.5 mm, 30 mm/s
and 500 Hz), so the largest error of a region is at most that of all ticks.

=============  ==============================================================================================
region         points
=============  ==============================================================================================
transition     within ``AFTER`` of the first or ``BEFORE`` of the last point: there the tools come from the
               contour above and leave for the next one
corner         elsewhere, turning sharper than ``CORNER_RADIUS`` and twice as sharp as a circle of the same length
wall           the rest
=============  ==============================================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.types import Array, Mask
from numpy.typing import NDArray

from isf_analysis.measures.force_metrics import BAND, engaged, has_set_point

REGIONS = ("transition", "corner", "wall")

AFTER, BEFORE = 6e-3, 3e-3
"""m after the first and before the last point: where force control goes slower because the tools step down."""
CORNER_RADIUS = 10e-3
"""m, assumed: two radii of the usual tool; in a tighter turn the contact moves over the tool, not along the wall."""
CHORD = 2e-3
"""m before and after a point over which its turn is measured: above the spacing of points, below a corner."""
SHARPER = 2.0
"""Times the curvature of a circle of the contour's length: a small round contour is not one corner."""

CONTACT = 5.0
"""N that count as contact, the default of force control (its parameter ``contact_threshold``)."""


@dataclass(frozen=True)
class PathForce:
    """Support force along one contour, the N points that were reached.

    Attributes
    ----------
    index : of the contour
    tip : (N, 3) m, streamed tip of the forming tool, frame ``sheet``
    along : (N,) 0..1, share of the path's length ; length : m
    force : (N,) N, normal force, positive in compression
    set_point : N, of the loop in full control, its median; NaN under position control
    wanted : (N,) N, set-points of the points: the contour's where they differ, else ``set_point``
    region : (N,) index into :data:`REGIONS`
    """

    index: int
    tip: Array
    along: Array
    length: float
    force: Array
    set_point: float
    wanted: Array
    region: NDArray[np.intp]

    @property
    def error(self) -> Array:
        """(N,) N, measured less set-point; NaN under position control."""
        return self.force - self.wanted

    @property
    def lost(self) -> Mask:
        """(N,) bool, less than ``CONTACT`` on the support tool."""
        return self.force < CONTACT


@dataclass(frozen=True)
class RegionForce:
    """Force in one region; N, NaN without points or without force control.

    Attributes
    ----------
    points : number of points ; share : of all points ; lost_share : fraction of its points without contact
    mean_error, rms_error, p99_abs_error, max_abs_error : of measured less set-point
    within_band : fraction of the points with an error of at most 10 N
    """

    points: int
    share: float
    lost_share: float
    mean_error: float
    rms_error: float
    p99_abs_error: float
    max_abs_error: float
    within_band: float


@dataclass(frozen=True)
class ContactLoss:
    """A stretch of one contour without contact: where it begins and its length in m."""

    contour: int
    start: tuple[float, float, float]
    length: float
    region: str


def path_forces(results: Sequence[ContourResult], contours: Sequence[Contour] = ()) -> tuple[PathForce, ...]:
    """Force along every contour that had a support tool in work and reached at least three points.

    ``contours`` that were to be formed have the set-points of the points, which results have by ticks alone, and say
    where the support tool waits.
    """
    planned = {contour.index: contour.support_force for contour in contours}
    waits = {contour.index for contour in contours if contour.support_waits}
    found = (
        _path_force(result, planned.get(result.index, np.empty(0)))
        for result in results
        if len(result.support_force) >= 3 and result.index not in waits
    )
    return tuple(item for item in found if item is not None)


def region_forces(paths: Sequence[PathForce]) -> dict[str, RegionForce]:
    """Numbers per region over all ``paths``, and of ``all`` of them; empty without paths."""
    if not paths:
        return {}
    region = np.concatenate([path.region for path in paths])
    error = np.concatenate([path.error for path in paths])
    lost = np.concatenate([path.lost for path in paths])
    masks = {name: region == k for k, name in enumerate(REGIONS)} | {"all": np.ones(len(region), dtype=bool)}
    return {name: _numbers(error[mask], lost[mask], len(region)) for name, mask in masks.items()}


def contact_losses(paths: Sequence[PathForce]) -> tuple[ContactLoss, ...]:
    """Stretches without contact in the order of forming; a single point counts half its neighbours' spacing."""
    losses = []
    for path in paths:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], path.lost, [False]]).astype(int)))
        middle = path.length * 0.5 * (path.along[1:] + path.along[:-1])
        borders = np.concatenate([[0.0], middle, [path.length]])
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            x, y, z = (float(value) for value in path.tip[begin])
            where = REGIONS[int(path.region[begin])]
            losses.append(ContactLoss(path.index, (x, y, z), float(borders[end] - borders[begin]), where))
    return tuple(losses)


def regions_along(tip: Array) -> NDArray[np.intp]:
    """(N,) index into :data:`REGIONS` of every point of a path ``tip`` (N, 3) m."""
    along = _arc_length(tip)
    region = np.full(len(tip), REGIONS.index("wall"))
    circle = 2 * np.pi / max(float(along[-1]), 1e-9)
    region[curvature(tip) > max(1.0 / CORNER_RADIUS, SHARPER * circle)] = REGIONS.index("corner")
    region[(along < AFTER) | (along > along[-1] - BEFORE)] = REGIONS.index("transition")
    return region


def curvature(tip: Array) -> Array:
    """(N,) 1/m, unsigned, of the path in the plan: the turn between the chords of ``CHORD`` before and after a point.

    A contour that comes back to within ``CHORD`` of its first point is taken as closed; an open one has no turn
    within ``CHORD`` of its ends.
    """
    along = _arc_length(tip)
    length = float(along[-1])
    gap = float(np.linalg.norm(tip[-1, :2] - tip[0, :2]))
    plan = tip[:, :2]
    if gap < CHORD and length > 4 * CHORD:
        period = length + gap
        along_all = np.concatenate([along - period, along, along + period])
        plan_all = np.tile(plan, (3, 1))
    else:
        along_all, plan_all = along, plan
    keep = np.concatenate([[True], np.diff(along_all) > 1e-12])
    before, here, after = (
        np.column_stack([np.interp(along + shift, along_all[keep], plan_all[keep, k]) for k in (0, 1)])
        for shift in (-CHORD, 0.0, CHORD)
    )
    first, second = here - before, after - here
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    turn = np.abs(np.arctan2(cross, (first * second).sum(axis=1)))
    return np.asarray(turn / CHORD)


def _path_force(result: ContourResult, planned: Array) -> PathForce | None:
    reached = np.asarray(np.isfinite(result.support_force).all(axis=1) & np.isfinite(result.support_target).all(axis=1))
    if reached.sum() < 3:
        return None
    forming, support = result.forming_target[reached], result.support_target[reached]
    across = support[:, :2] - forming[:, :2]
    distance = np.linalg.norm(across, axis=1)
    # one tool above the other has no horizontal normal
    with np.errstate(invalid="ignore", divide="ignore"):
        force = (across * result.support_force[reached, :2]).sum(axis=1) / np.where(distance > 1e-6, distance, np.nan)
    known = np.isfinite(force)
    if known.sum() < 3:
        return None
    tip, force = forming[known], force[known]
    along = _arc_length(tip)
    set_point = float("nan")
    wanted = np.full(len(force), np.nan)
    if has_set_point(result) and engaged(result).any():
        used = result.tick_set_point[engaged(result)]
        set_point = float(np.median(used))
        wanted = np.full(len(force), set_point)
        # a set-point given at the start replaces those of the contour: the ticks have one only
        if np.ptp(used) >= 1.0 and len(planned) == len(reached):
            wanted = planned[reached][known]
    length = float(along[-1])
    share = along / max(length, 1e-12)
    return PathForce(result.index, tip, share, length, force, set_point, wanted, regions_along(tip))


def _numbers(error: Array, lost: Mask, total: int) -> RegionForce:
    points = len(lost)
    nan = float("nan")
    share, lost_share = points / total, float(lost.mean()) if points else nan
    size = np.abs(error[np.isfinite(error)])
    if not len(size):
        return RegionForce(points, share, lost_share, nan, nan, nan, nan, nan)
    return RegionForce(
        points=points,
        share=share,
        lost_share=lost_share,
        mean_error=float(np.nanmean(error)),
        rms_error=float(np.sqrt(np.mean(size**2))),
        p99_abs_error=float(np.quantile(size, 0.99)),
        max_abs_error=float(size.max()),
        within_band=float(np.mean(size <= BAND)),
    )


def _arc_length(tip: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
