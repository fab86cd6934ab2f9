"""Functions of the position along one contour: lengths, sector means, control points, neighbours in plan view.

A *loop function* is an array (N,) over the points of a contour. Closed contours are periodic, open ones are
continued by their end values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.types import Array
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
