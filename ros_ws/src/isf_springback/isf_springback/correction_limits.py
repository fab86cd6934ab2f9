"""Limits that keep a correction from leaving marks or jumping: magnitude, gradient, smoothing, change.

Follows Ren 2018 (4.3.1): at most 50 um of correction per mm of path, a moving average over the tool diameter, and a
change of at most twice the incremental depth from contour to contour. Different from there, the gradient limit has
no direction (it does not depend on where the contour starts) and holds across the seam of a closed contour, and the
change limit holds at every point and not only on average.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.loop_path import LoopPath, moving_average

_VISIBLE = 1e-6
"""m; a smaller effect of a limit is not reported."""


@dataclass(frozen=True)
class CorrectionLimits:
    """Limits of one correction.

    Attributes
    ----------
    gradient : m of correction per m of path (published: 50 um/mm)
    smoothing : m of path averaged (published: tool diameter 2 R)
    change : m, largest change at a place from one contour to the next (published: 2 incremental depths)
    magnitude : m, largest correction (assumed)
    """

    gradient: float
    smoothing: float
    change: float
    magnitude: float


@dataclass(frozen=True)
class LimitedCorrection:
    """A correction within its limits, N points.

    Attributes
    ----------
    value : (N,) m
    saturated : (N,) bool, a limit (not the smoothing) changed the point
    magnitude_limited : the absolute limit was reached
    """

    value: Array
    saturated: NDArray[np.bool_]
    magnitude_limited: bool


def limit_correction(
    requested: Array,
    path: LoopPath,
    limits: CorrectionLimits,
    previous: Array | None = None,
    start: float | None = None,
) -> LimitedCorrection:
    """Nearest admissible correction to ``requested`` (N,) m, positive along the push direction.

    Parameters
    ----------
    previous : (N,) m, correction of the last contour seen from the points of this one; None: nothing was
        corrected before, the change counts from zero
    start : m, correction where the path begins; only for open paths, which continue the last one

    Never negative: a correction pushes, it does not pull the tool back from the planned path.
    """
    within = np.clip(requested, 0.0, limits.magnitude)
    smooth = moving_average(path, within, limits.smoothing)
    value = moving_average(path, limit_gradient(path, within, limits.gradient), limits.smoothing)
    base = np.zeros(len(path)) if previous is None else np.clip(previous, 0.0, limits.magnitude)
    base = limit_gradient(path, base, limits.gradient)
    value = np.clip(value, base - limits.change, base + limits.change)
    if start is not None and not path.closed:
        reach = limits.gradient * path.position
        value = np.clip(value, start - reach, start + reach)
    value = np.clip(value, 0.0, limits.magnitude)
    over = requested > limits.magnitude
    saturated = (np.abs(value - smooth) > _VISIBLE) | over
    return LimitedCorrection(value, saturated, bool(over.any()))


def limit_gradient(path: LoopPath, values: Array, gradient: float) -> Array:
    """(N,) loop function with slope at most ``gradient`` along the path, periodic on a closed one.

    Mean of the largest admissible function below ``values`` and the smallest one above it; a function within the
    limit is returned unchanged.
    """
    below = below_values(path, values, gradient)
    above = -below_values(path, -values, gradient)
    return np.asarray(0.5 * (below + above))


def below_values(path: LoopPath, values: Array, gradient: float) -> Array:
    """(N,) largest function of at most that slope that is nowhere above ``values``, periodic on a closed path.

    min over t of values(t) + gradient |s - t|: two running minima; three laps make it periodic.
    """
    n = len(values)
    position, laps = path.position, values
    if path.closed:
        position = np.concatenate([position - path.length, position, position + path.length])
        laps = np.tile(values, 3)
    slope = gradient * position
    forward = np.minimum.accumulate(laps - slope) + slope
    backward = np.minimum.accumulate((laps + slope)[::-1])[::-1] - slope
    both = np.minimum(forward, backward)
    return both[n : 2 * n] if path.closed else both
