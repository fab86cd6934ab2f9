"""From a path of both tools to commanded tips at every control tick.

A path is a polyline of both tips with quantities that ride along. It is passed from rest to rest with a feed that is
lowered where the direction of a tip changes, and then rounded by two moving averages over time, as motion controllers
blend their moves. That gives, for any polyline (Delta q' is the change of direction of a tip per unit of path
within one blend, T the blend time)::

    v <= a_c T / |Delta q'|         =>   |acceleration| <= a_t + a_c of either tip, no overshoot, no step

with a_t = a_c = half the acceleration limit, and a tip never leaves the convex hull of its polyline. The
forming tip moves at the feed; the support tip may be up to ``SUPPORT_RATIO`` times faster, where it runs on the outside
of a corner, else the feed is lowered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SUPPORT_RATIO = 2.0
"""Largest ratio of the speed of the support tip to the feed."""

GRID = 0.2e-3
"""m, spacing at which the speed along the path is planned."""


@dataclass(frozen=True)
class Limits:
    """Limits of a motion: ``rate`` Hz, ``acceleration`` m/s^2, ``blend_time`` and ``jerk_time`` s."""

    rate: float
    acceleration: float
    blend_time: float
    jerk_time: float

    @property
    def blend_ticks(self) -> int:
        """Ticks of the first average."""
        return max(2, round(self.blend_time * self.rate))

    @property
    def jerk_ticks(self) -> int:
        """Ticks of the second average."""
        return max(1, round(self.jerk_time * self.rate))


@dataclass(frozen=True)
class ToolPath:
    """Polyline of both tools, M vertices.

    Attributes
    ----------
    tip_1, tip_2 : (M, 3) m
    direction : (M,) rad, continuous angle of the horizontal normal d_n in the sheet plane
    set_point : (M,) N, NaN under position control
    coordinate : (M,) contour coordinate: i at contour point i, NaN outside a contour
    arm : m, length at which a change of ``direction`` counts as motion (largest offset along d_n)
    """

    tip_1: Array
    tip_2: Array
    direction: Array
    set_point: Array
    coordinate: Array
    arm: float = 0.0


@dataclass(frozen=True)
class Motion:
    """Commanded motion at T control ticks, from rest to rest.

    Attributes
    ----------
    tip_1, tip_2 : (T, 3) m
    normal : (T, 2) unit horizontal vector d_n from forming to support tool
    set_point : (T,) N, NaN under position control
    coordinate : (T,) contour coordinate, NaN outside a contour
    speed : (T,) m/s of the faster tip, or of tool 1 along a contour
    """

    tip_1: Array
    tip_2: Array
    normal: Array
    set_point: Array
    coordinate: Array
    speed: Array

    def __len__(self) -> int:
        return len(self.tip_1)


def sample(path: ToolPath, feed: float, limits: Limits) -> Motion:
    """Motion along ``path`` with at most ``feed`` m/s of tip 1, at every tick of ``limits.rate``.

    The first sample is the first vertex, the last the last vertex, both at rest.
    """
    position = _path_coordinate(path)
    if position[-1] <= 1e-9:
        return _standstill(path)
    travelled = _timed(position, *_speed_plan(path, position, feed, limits), limits.rate)

    columns = np.column_stack(
        [
            path.tip_1,
            path.tip_2,
            path.arm * np.cos(path.direction),
            path.arm * np.sin(path.direction),
            np.cos(path.direction),
            np.sin(path.direction),
            path.set_point,
            path.coordinate,
        ]
    )
    sampled = np.column_stack([np.interp(travelled, position, column) for column in columns.T])
    smooth = _average(_average(sampled, limits.blend_ticks), limits.jerk_ticks)
    smooth[0], smooth[-1] = columns[0], columns[-1]
    normal = smooth[:, 8:10] / np.linalg.norm(smooth[:, 8:10], axis=1)[:, None]
    tip_1, tip_2 = smooth[:, 0:3], smooth[:, 3:6]
    return Motion(tip_1, tip_2, normal, smooth[:, 10], smooth[:, 11], _speed(tip_1, tip_2, limits.rate))


def straight(tip_1: Array, tip_2: Array, angle: tuple[float, float], arm: float) -> ToolPath:
    """Path along the vertices ``tip_1``, ``tip_2`` (M, 3) while d_n turns from ``angle[0]`` to ``angle[1]`` (rad)."""
    count = len(tip_1)
    turn = np.remainder(angle[1] - angle[0] + np.pi, 2 * np.pi) - np.pi
    pieces = 1 + int(np.ceil(abs(turn) / 0.1))
    at = np.linspace(0.0, count - 1.0, (count - 1) * pieces + 1)
    vertices = np.arange(count)
    return ToolPath(
        tip_1=np.column_stack([np.interp(at, vertices, c) for c in np.asarray(tip_1, dtype=float).T]),
        tip_2=np.column_stack([np.interp(at, vertices, c) for c in np.asarray(tip_2, dtype=float).T]),
        direction=angle[0] + turn * at / max(count - 1, 1),
        set_point=np.full(len(at), np.nan),
        coordinate=np.full(len(at), np.nan),
        arm=arm,
    )


def horizontal_direction(forming: Array, support: Array, least: float) -> Array | None:
    """(N,) rad, continuous angle of d_n from forming to support ball centre (Ren 2018 eq. 2-2), from commanded tips.

    Where the centres are less than ``least`` m apart in the plane, d_n is interpolated between its
    neighbours; None when that is so everywhere. The balls' centres lie above their tips, so tips serve as well.
    """
    apart = support[:, :2] - forming[:, :2]
    valid = np.linalg.norm(apart, axis=1) >= least
    if not valid.any():
        return None
    angle = np.unwrap(np.arctan2(apart[valid, 1], apart[valid, 0]))
    return np.asarray(np.interp(np.arange(len(apart)), np.flatnonzero(valid), angle))


def _path_coordinate(path: ToolPath) -> Array:
    """(M,) m, path coordinate in which ``feed`` is the largest speed; strictly ascending."""
    step = np.maximum(
        np.linalg.norm(np.diff(path.tip_1, axis=0), axis=1),
        np.linalg.norm(np.diff(path.tip_2, axis=0), axis=1) / SUPPORT_RATIO,
    )
    step = np.maximum(step, np.abs(np.diff(path.direction)) * path.arm)
    return np.concatenate([[0.0], np.cumsum(np.maximum(step, 1e-12))])


def _speed_plan(path: ToolPath, position: Array, feed: float, limits: Limits) -> tuple[Array, Array]:
    """Grid (K,) m along the path and speed (K,) m/s at it, at rest at both ends."""
    spacing = np.diff(position)
    span = feed * (limits.blend_ticks + 2) / limits.rate
    blend = limits.blend_ticks / limits.rate
    arm = path.arm * np.column_stack([np.cos(path.direction), np.sin(path.direction)])
    slope_1 = np.diff(path.tip_1, axis=0) / spacing[:, None]
    slope_2 = np.diff(path.tip_2, axis=0) / spacing[:, None]
    slope_arm = np.diff(arm, axis=0) / spacing[:, None]
    turn = np.maximum(_variation(slope_1), _variation(slope_2)) + _variation(slope_arm)
    steepest = max(1.0, float(np.linalg.norm(slope_2, axis=1).max() + np.linalg.norm(slope_arm, axis=1).max()))

    grid = np.linspace(0.0, position[-1], max(8, int(np.ceil(position[-1] / GRID))) + 1)
    spacing_grid = grid[1]
    turned = np.concatenate([[0.0], np.cumsum(turn)])
    inner = position[1:-1]
    after = np.searchsorted(inner, grid + span + spacing_grid, side="right")
    before = np.searchsorted(inner, grid - span - spacing_grid, side="left")
    nearby = turned[after] - turned[before]
    speed = np.minimum(feed, 0.5 * limits.acceleration * blend / np.maximum(nearby, 1e-9))
    speed[0] = speed[-1] = 0.0
    return grid, _reachable(speed, spacing_grid, 0.5 * limits.acceleration / steepest)


def _variation(slope: Array) -> Array:
    """(M-2,) size of the change of a direction vector at the inner vertices."""
    return np.asarray(np.linalg.norm(np.diff(slope, axis=0), axis=1))


def _reachable(speed: Array, spacing: float, acceleration: float) -> Array:
    """Speeds lowered so that each can be reached from its neighbours with ``acceleration``."""
    gain = 2 * acceleration * spacing
    squares: list[float] = (speed**2).tolist()
    for order in (range(1, len(squares)), range(len(squares) - 2, -1, -1)):
        step = 1 if order.step > 0 else -1
        for i in order:
            reach = squares[i - step] + gain
            squares[i] = min(reach, squares[i])
    return np.sqrt(squares)


def _timed(position: Array, grid: Array, speed: Array, rate: float) -> Array:
    """(T,) m, path coordinate at every tick, constant acceleration within each grid interval."""
    duration = 2 * np.diff(grid) / (speed[:-1] + speed[1:])
    start = np.concatenate([[0.0], np.cumsum(duration)])
    time = np.arange(int(np.ceil(start[-1] * rate)) + 1) / rate
    cell = np.clip(np.searchsorted(start, time, side="right") - 1, 0, len(duration) - 1)
    since = np.minimum(time - start[cell], duration[cell])
    acceleration = (speed[1:] - speed[:-1])[cell] / duration[cell]
    travelled = grid[cell] + speed[cell] * since + 0.5 * acceleration * since**2
    travelled[-1] = position[-1]
    return np.asarray(np.clip(travelled, 0.0, position[-1]))


def _average(columns: Array, ticks: int) -> Array:
    """Columns averaged over ``ticks``, extended at rest so that the ends are reached."""
    if ticks < 2:
        return columns
    first = np.repeat(columns[:1], ticks, axis=0)
    last = np.repeat(columns[-1:], ticks, axis=0)
    reference = columns[0]
    total = np.cumsum(np.concatenate([first, columns, last]) - reference, axis=0)
    return np.asarray(reference + (total[ticks:] - total[:-ticks]) / ticks)


def _speed(tip_1: Array, tip_2: Array, rate: float) -> Array:
    """(T,) m/s, speed of tip 1, or of tip 2 where tip 1 rests."""
    first = np.linalg.norm(np.diff(tip_1, axis=0), axis=1)
    second = np.linalg.norm(np.diff(tip_2, axis=0), axis=1)
    return np.concatenate([[0.0], np.where(first > 1e-12, first, second) * rate])


def _standstill(path: ToolPath) -> Motion:
    """One tick at the first vertex."""
    normal = np.array([[np.cos(path.direction[0]), np.sin(path.direction[0])]])
    return Motion(path.tip_1[:1], path.tip_2[:1], normal, path.set_point[-1:], path.coordinate[-1:], np.zeros(1))
