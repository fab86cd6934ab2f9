"""Functions of the position along one contour: lengths, means, neighbours in plan view, and the limits of a correction.

A *loop function* is an array (N,) over the points of a contour. Closed contours are periodic, open ones are continued
by their end values. Limits of one component of a correction are those of its slope along the path, its change from
contour to contour and its magnitude; published for the push (Ren 2018, 4.3.1): 50 um per mm of path, two incremental
depths per contour, averaged over a tool diameter of path. The average is taken after the slope is limited; it keeps the
slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_core.types import Array, Mask
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class LoopPath:
    """Positions along a contour in plan view.

    Attributes
    ----------
    position : (N,) m, distance along the path from the first point, strictly increasing
    length : m, of the whole path; of a closed one with the way back to the first point
    closed : the path is periodic
    """

    position: Array
    length: float
    closed: bool

    @staticmethod
    def of(contour: Contour) -> LoopPath:
        """Path of the forming tip in x and y (the plane in which tools trace a level)."""
        return LoopPath.through(contour.forming_tip[:, :2], closed=contour.closed)

    @staticmethod
    def through(points: Array, *, closed: bool) -> LoopPath:
        """Path through ``points`` (N, 2) m; coincident neighbours are held 1 nm apart."""
        steps = np.maximum(np.linalg.norm(np.diff(points, axis=0), axis=1), 1e-9)
        position = np.concatenate([[0.0], np.cumsum(steps)])
        back = max(float(np.linalg.norm(points[0] - points[-1])), 1e-9) if closed else 0.0
        return LoopPath(position, float(position[-1]) + back, closed)

    def __len__(self) -> int:
        return len(self.position)

    def at(self, values: Array, position: Array) -> Array:
        """(M,) loop function ``values`` (N,) interpolated linearly at ``position`` (M,) m."""
        period = self.length if self.closed else None
        return np.asarray(np.interp(position, self.position, values, period=period))

    def even_positions(self, count: int) -> Array:
        """(count,) m, evenly spread positions; the middle of ``count`` sectors of equal length."""
        return np.asarray((np.arange(count) + 0.5) * (self.length / count))


@dataclass(frozen=True)
class LoopSamples:
    """M evenly spread places along a contour of N points, the middles of sectors of equal length.

    Attributes
    ----------
    path : of the contour
    position : (M,) m along it
    contact : (M, 3) m ; tip : (M, 2) m, of the forming tool ; wall_angle : (M,) rad
    """

    path: LoopPath
    position: Array
    contact: Array
    tip: Array
    wall_angle: Array

    @staticmethod
    def of(contour: Contour, count: int) -> LoopSamples:
        """``count`` places of ``contour``."""
        path = LoopPath.of(contour)
        position = path.even_positions(count)
        contact = np.column_stack([path.at(contour.contact[:, axis], position) for axis in range(3)])
        tip = np.column_stack([path.at(contour.forming_tip[:, axis], position) for axis in range(2)])
        return LoopSamples(path, position, contact, tip, path.at(contour.wall_angle, position))

    def along(self, *values: Array) -> list[Array]:
        """Values (M,) at the places as loop functions (N,), interpolated linearly."""
        period = self.path.length if self.path.closed else None
        return [np.asarray(np.interp(self.path.position, self.position, each, period=period)) for each in values]


def moving_average(path: LoopPath, values: Array, window: float) -> Array:
    """(N,) mean of a loop function over ``window`` m of path around every point.

    Taken on an even grid, so the spacing of the points does not weigh; a function with slope limit g keeps
    the limit. The window is at most the length of the path.
    """
    if window <= 0.0:
        return values
    width = min(window, path.length)
    count = int(np.clip(np.ceil(16 * path.length / width), len(path), 8 * len(path) + 64))
    step = path.length / count if path.closed else path.length / max(count - 1, 1)
    grid = step * np.arange(count, dtype=np.float64)
    size = 2 * round(0.5 * (width / step - 1.0)) + 1
    size = max(1, min(size, count if count % 2 else count - 1))
    even = uniform_filter1d(path.at(values, grid), size, mode="wrap" if path.closed else "nearest")
    period = path.length if path.closed else None
    return np.asarray(np.interp(path.position, grid, even, period=period))


def nearest_points(points: Array, others: Array) -> NDArray[np.intp]:
    """(N,) index of the nearest of ``others`` (M, 2) m in plan view for each of ``points`` (N, 2) m."""
    _, index = cKDTree(others).query(points)
    return np.asarray(index, dtype=np.intp)


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


def forming_radii(job_file: JobFile) -> dict[int, float]:
    """m, the same by the number of the tool."""
    return {tool: forming_radius(job_file, tool) for tool in (1, 2)}


def limit_along(
    contour: Contour, requested: Array, limits: Limits, previous: Array, start: float | None = None
) -> tuple[Array, Mask]:
    """:func:`limit` along the path of ``contour``."""
    return limit(requested, LoopPath.of(contour), limits, previous, start)


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
