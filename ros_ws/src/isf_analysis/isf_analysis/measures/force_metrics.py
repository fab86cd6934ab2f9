"""How well the support force was held, from the measured force at every control tick.

The numbers are of the *raw* normal force of the load cell (before the controller's own low-pass filter), so they hold
the noise of the load cell as well as the error of the control. Only engaged ticks count: the set-point ramps at the
start and end of a contour are left out, and ``engaged_fraction`` tells how much that leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import ContourResult
from numpy.typing import NDArray

BAND = 10.0
"""N around the set-point: the accuracy that Ren 2018 (section 1.3, 2.4) gives for contact-force control."""


@dataclass(frozen=True)
class ForceMetrics:
    """Accuracy of the support force over some contours; forces in N, NaN when no tick was engaged.

    Attributes
    ----------
    set_point : median set-point of the engaged ticks ; lowest, highest : that they go to, by rules or by wall angle
    mean_error, rms_error : of measured minus set-point
    p99_abs_error, p999_abs_error, max_abs_error : |error| that 99 %, 99.9 %, all of the engaged ticks stay below
    within_band : fraction of the engaged ticks with |error| <= BAND
    contact_fraction : fraction of the engaged ticks with contact, as counted by the controller
    engaged_ticks : number of engaged ticks, engaged_fraction : of all ticks of these contours
    engaged_time : s
    """

    set_point: float
    lowest: float
    highest: float
    mean_error: float
    rms_error: float
    p99_abs_error: float
    p999_abs_error: float
    max_abs_error: float
    within_band: float
    contact_fraction: float
    engaged_ticks: int
    engaged_fraction: float
    engaged_time: float


def force_metrics(results: Sequence[ContourResult], control_rate: float) -> ForceMetrics | None:
    """Metrics over ``results``; None when none of them was under force control.

    ``control_rate`` (Hz) turns engaged ticks into time, NaN where it is not known (0).
    """
    controlled = [result for result in results if has_set_point(result)]
    if not controlled:
        return None
    ticks = sum(len(result.tick_normal_force) for result in controlled)
    set_point = np.concatenate([result.tick_set_point[engaged(result)] for result in controlled])
    force = np.concatenate([result.tick_normal_force[engaged(result)] for result in controlled])
    if not len(force):
        nan = float("nan")
        return ForceMetrics(nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, 0, 0.0, 0.0)
    error = force - set_point
    size = np.abs(error)
    weights = np.array([np.count_nonzero(engaged(result)) for result in controlled], dtype=float)
    contact = np.array([result.contact_fraction for result in controlled])
    return ForceMetrics(
        set_point=float(np.median(set_point)),
        lowest=float(set_point.min()),
        highest=float(set_point.max()),
        mean_error=float(error.mean()),
        rms_error=float(np.sqrt(np.mean(error**2))),
        p99_abs_error=float(np.quantile(size, 0.99)),
        p999_abs_error=float(np.quantile(size, 0.999)),
        max_abs_error=float(size.max()),
        within_band=float(np.mean(size <= BAND)),
        contact_fraction=float(np.average(contact, weights=weights)),
        engaged_ticks=len(force),
        engaged_fraction=len(force) / ticks,
        engaged_time=len(force) / control_rate if control_rate > 0.0 else float("nan"),
    )


def by_place(lowest: float | None, highest: float | None) -> str:
    """``100 to 200 N`` where the set-points differ, by rules or by wall angle; empty where there is one."""
    if lowest is None or highest is None or not highest - lowest >= 1.0:
        return ""
    return f"{lowest:.0f} to {highest:.0f} N"


def has_set_point(result: ContourResult) -> bool:
    """True when the contour was formed under force control."""
    return len(result.tick_set_point) > 0 and len(result.tick_set_point) == len(result.tick_normal_force)


def engaged(result: ContourResult) -> NDArray[np.bool_]:
    """(T,) bool, ticks in which the loop was in full control and the force was measured."""
    return result.tick_engaged & np.isfinite(result.tick_normal_force) & np.isfinite(result.tick_set_point)


def rms_by_contour(results: Sequence[ContourResult], rate: float) -> dict[int, float]:
    """N, rms of the force error by contour, ticks at ``rate`` Hz; of those under force control."""
    found = {result.index: force_metrics([result], rate) for result in results}
    return {index: metrics.rms_error for index, metrics in found.items() if metrics is not None}
