"""Limits of one component of a correction: slope along the path, change from contour to contour, magnitude.

Published for the push (Ren 2018, 4.3.1): 50 um per mm of path, two incremental depths per contour, averaged over a tool
diameter of path. The average is taken after the slope is limited; it keeps the slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.files.job import JobFile
from isf_core.types import Array, Mask

from isf_springback.loop_path import LoopPath, moving_average

PUSH_SLOPE = 50e-6 / 1e-3
"""m of push per m of path (published: Ren 2018, 4.3.1)."""

HORIZONTAL_SLOPE = 0.2
"""m of horizontal offset per m of path (assumed; the published 0.05 of the push would smear the corners of a
pyramid, where horizontal springback rises by 1.5 mm within some 10 mm of path, Lu 2016, 4.3.2)."""

CHANGE_PER_DEPTH = 2.0
"""Largest change from contour to contour in incremental depths (published: Ren 2018, 4.3.1)."""

LARGEST_CORRECTION = 10e-3
"""m (assumed: twice the 5.4 mm predicted for the largest published part, Praveen 2020, 3.2)."""

NEGLIGIBLE = 1e-6
"""m; a smaller effect of a limit is not reported."""


@dataclass(frozen=True)
class Limits:
    """Limits of one component of the offset.

    Attributes
    ----------
    slope : m of correction per m of path
    average : m of path averaged
    change : m, largest change at a place from one contour to the next
    smallest, largest : m, range of the correction; 0 for ``smallest``: the tool is never led back
    """

    slope: float
    average: float
    change: float
    largest: float
    smallest: float = -np.inf


def change_per_contour(job_file: JobFile) -> float:
    """m, published largest change of a correction from one contour to the next."""
    return CHANGE_PER_DEPTH * job_file.job.path.incremental_depth


def forming_radius(job_file: JobFile, forming_tool: int) -> float:
    """m, radius of the forming tool of a contour."""
    job = job_file.job
    tool = job.tool_1 if forming_tool == 1 or job.tool_2 is None else job.tool_2
    return tool.radius


def push_limits(
    job_file: JobFile, forming_tool: int, change: float, largest: float = LARGEST_CORRECTION, smallest: float = -np.inf
) -> Limits:
    """Limits of the push; ``change``, ``largest``, ``smallest`` in m."""
    return Limits(PUSH_SLOPE, 2.0 * forming_radius(job_file, forming_tool), change, largest, smallest)


def horizontal_limits(job_file: JobFile, forming_tool: int, largest: float = LARGEST_CORRECTION) -> Limits:
    """Limits of a horizontal component; averaged over half the way of the push, so that corners stay."""
    radius = forming_radius(job_file, forming_tool)
    return Limits(HORIZONTAL_SLOPE, radius, change_per_contour(job_file), largest, -largest)


def limit(
    requested: Array, path: LoopPath, limits: Limits, previous: Array, start: float | None = None
) -> tuple[Array, Mask]:
    """Admissible component (N,) m nearest to ``requested`` (N,) m, and where a limit (not the average) changed it.

    Parameters
    ----------
    previous : (N,) m, the component on the contour before, seen from the points of this one
    start : m, the component where an open path begins, which continues the contour before; closed paths ignore it
    """
    within = np.clip(requested, limits.smallest, limits.largest)
    smooth = moving_average(path, within, limits.average)
    value = moving_average(path, limit_slope(path, within, limits.slope), limits.average)
    base = limit_slope(path, np.clip(previous, limits.smallest, limits.largest), limits.slope)
    value = np.clip(value, base - limits.change, base + limits.change)
    if start is not None and not path.closed:
        reach = limits.slope * path.position
        value = np.clip(value, start - reach, start + reach)
    value = np.clip(value, limits.smallest, limits.largest)
    limited = (np.abs(value - smooth) > NEGLIGIBLE) | (requested > limits.largest)
    return np.asarray(value), np.asarray(limited)


def limit_slope(path: LoopPath, values: Array, slope: float) -> Array:
    """(N,) loop function with slope at most ``slope`` along the path, periodic on a closed one.

    Mean of the largest admissible function below ``values`` and the smallest one above it; a function within the
    limit is returned unchanged.
    """
    below = below_values(path, values, slope)
    above = -below_values(path, -values, slope)
    return np.asarray(0.5 * (below + above))


def below_values(path: LoopPath, values: Array, slope: float) -> Array:
    """(N,) largest function of at most that slope that is nowhere above ``values``, periodic on a closed path.

    min over t of values(t) + slope |s - t|: two running minima; three laps make it periodic.
    """
    n = len(values)
    position, laps = path.position, values
    if path.closed:
        position = np.concatenate([position - path.length, position, position + path.length])
        laps = np.tile(values, 3)
    rise = slope * position
    forward = np.minimum.accumulate(laps - rise) + rise
    backward = np.minimum.accumulate((laps + rise)[::-1])[::-1] - rise
    both = np.minimum(forward, backward)
    return both[n : 2 * n] if path.closed else both


def fade_horizontal(wanted: Array, last: Array, change: float) -> tuple[Array, Mask]:
    """(N, 2) m near ``wanted`` (N, 2) m, at most ``change`` m from ``last`` (N, 2) m, and where that held it back."""
    way = wanted - last
    size = np.linalg.norm(way, axis=1)
    far = size > change
    if not far.any():
        return wanted, far
    share = np.where(far, change / np.maximum(size, 1e-12), 1.0)
    return np.asarray(last + share[:, None] * way), far
