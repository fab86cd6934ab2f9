"""From a path of both tools to commanded tips at every control tick.

A path is a polyline of both tips with quantities that ride along. It is passed from rest to rest with a feed that is
lowered where the direction of a tip changes, and then rounded by two moving averages over time, as motion controllers
blend their moves. That gives, for any polyline (Delta q' is the change of direction of a tip per unit of path
within one blend, T the blend time)::

    v <= a_c T / |Delta q'|         =>   |acceleration| <= a_t + a_c of either tip, no overshoot, no step

with a_t = a_c = half the acceleration limit, and a tip never leaves the convex hull of its polyline. A path may also
be entered or left in motion (turns of a spiral): there it is taken to run on, with the speed and turn of its end. The
forming tip moves at the feed; the support tip may be up to ``SUPPORT_RATIO`` times faster, where it runs on the outside
of a corner, else the feed is lowered.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isf_core.geometry.tool_axis import UP, angle_between, between
from isf_core.types import Array
from scipy.ndimage import minimum_filter1d

SUPPORT_RATIO = 2.0
"""Largest ratio of the speed of the support tip to the feed."""

HOLDER_RATIO = 3.0
"""Least ratio of the feed to the speed of the blank holder, which is heavy."""

GRID = 0.2e-3
"""m, spacing at which the speed along the path is planned."""


@dataclass(frozen=True)
class Limits:
    """Limits of a motion: ``rate`` Hz, ``acceleration`` m/s^2, ``blend_time`` and ``jerk_time`` s.

    The acceleration is that of both tips and, where its axis turns, of tool 1 at ``tilt_lever`` m from the tip, too.
    """

    rate: float
    acceleration: float
    blend_time: float
    jerk_time: float
    tilt_lever: float = 0.0

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
    direction : (M,) rad, continuous angle in the sheet plane of the horizontal direction from tool 1 to tool 2
    set_point : (M,) N, NaN under position control
    coordinate : (M,) contour coordinate: i at contour point i, NaN outside a contour
    arm : m, length at which a change of ``direction`` counts as motion (largest offset along d_n)
    forming : tool (1, 2) that moves at the feed
    speed : (M,) m/s, largest speed of the forming tip at the vertices, or (0,)
    holder : (M,) m, height of the blank holder, or (0,) for 0
    axis : (M, 3), axis of tool 1, or (0, 3) where it is upright all along
    axis_arm : m, length at which a turn of ``axis`` counts as motion
    """

    tip_1: Array
    tip_2: Array
    direction: Array
    set_point: Array
    coordinate: Array
    arm: float = 0.0
    forming: int = 1
    speed: Array = field(default_factory=lambda: np.empty(0))
    holder: Array = field(default_factory=lambda: np.empty(0))
    axis: Array = field(default_factory=lambda: np.empty((0, 3)))
    axis_arm: float = 0.0

    @property
    def forming_tip(self) -> Array:
        """(M, 3) m, tip of the tool that moves at the feed."""
        return self.tip_1 if self.forming == 1 else self.tip_2

    @property
    def support_tip(self) -> Array:
        """(M, 3) m, tip of the other tool."""
        return self.tip_2 if self.forming == 1 else self.tip_1


@dataclass(frozen=True)
class Motion:
    """Commanded motion at T control ticks, from rest to rest unless it was sampled otherwise.

    Attributes
    ----------
    tip_1, tip_2 : (T, 3) m
    normal : (T, 2) unit horizontal vector from tool 1 to tool 2
    set_point : (T,) N, NaN under position control
    coordinate : (T,) contour coordinate, NaN outside a contour
    speed : (T,) m/s of the forming tip, or of the other one where that rests
    holder : (T,) m, height of the blank holder
    axis : (T, 3), axis of tool 1, or (0, 3) where it is upright
    """

    tip_1: Array
    tip_2: Array
    normal: Array
    set_point: Array
    coordinate: Array
    speed: Array
    holder: Array
    axis: Array = field(default_factory=lambda: np.empty((0, 3)))

    def __len__(self) -> int:
        return len(self.tip_1)


def sample(path: ToolPath, feed: float, limits: Limits, *, entry: float = 0.0, runs_on: bool = False) -> Motion:
    """Motion along ``path`` with at most ``feed`` m/s of the forming tip, at every tick of ``limits.rate``.

    The first sample is the first vertex, the last the last vertex. It begins with ``entry`` m/s (0: at rest) and ends
    at rest, or, when it ``runs_on``, at the speed that the path allows there (the last one of ``speed``).
    """
    position = _path_coordinate(path)
    if position[-1] <= 1e-9:
        return _standstill(path)
    speeds = _speed_plan(path, position, feed, limits, entry, runs_on=runs_on)
    travelled = _timed(position, *speeds, limits.rate, whole=runs_on)

    holder = path.holder if len(path.holder) else np.zeros(len(path.tip_1))
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
            holder,
            *path.axis.T[: 3 * bool(len(path.axis))],
        ]
    )
    sampled = np.column_stack([np.interp(travelled, position, column) for column in columns.T])
    smooth = sampled
    for ticks in (limits.blend_ticks, limits.jerk_ticks):
        smooth = _average(smooth, ticks, in_motion=(entry > 0.0, runs_on))
    if entry > 0.0:
        smooth[0, _HELD] = columns[0, _HELD]
    else:
        smooth[0] = columns[0]
    if runs_on:
        smooth[-1, _HELD] = columns[-1, _HELD]
    else:
        smooth[-1] = columns[-1]
    normal = smooth[:, 8:10] / np.linalg.norm(smooth[:, 8:10], axis=1)[:, None]
    tip_1, tip_2 = smooth[:, 0:3], smooth[:, 3:6]
    forming, support = (tip_1, tip_2) if path.forming == 1 else (tip_2, tip_1)
    speed = _speed(forming, support, limits.rate, entry)
    axis = smooth[:, 13:16]
    if len(path.axis):
        axis = axis / np.linalg.norm(axis, axis=1)[:, None]
    return Motion(tip_1, tip_2, normal, smooth[:, 10], smooth[:, 11], speed, smooth[:, 12], axis)


def straight(
    tip_1: Array,
    tip_2: Array,
    angle: tuple[float, float],
    arm: float,
    *,
    forming: int = 1,
    holder: tuple[float, float] = (0.0, 0.0),
    axis: tuple[Array, Array] = (UP, UP),
    axis_arm: float = 0.0,
) -> ToolPath:
    """Path along the vertices ``tip_1``, ``tip_2`` (M, 3) while d_n turns from ``angle[0]`` to ``angle[1]`` (rad).

    The blank ``holder`` moves from its first to its second height (m) meanwhile, and the ``axis`` of tool 1 turns from
    the first one to the second on a great circle.
    """
    count = len(tip_1)
    turn = np.remainder(angle[1] - angle[0] + np.pi, 2 * np.pi) - np.pi
    tilts = not (np.array_equal(axis[0], UP) and np.array_equal(axis[1], UP))
    lean = float(angle_between(*axis)) if tilts else 0.0
    pieces = 1 + int(np.ceil(max(abs(turn), lean) / 0.1))
    at = np.linspace(0.0, count - 1.0, (count - 1) * pieces + 1)
    vertices = np.arange(count)
    return ToolPath(
        tip_1=np.column_stack([np.interp(at, vertices, c) for c in np.asarray(tip_1, dtype=float).T]),
        tip_2=np.column_stack([np.interp(at, vertices, c) for c in np.asarray(tip_2, dtype=float).T]),
        direction=angle[0] + turn * at / max(count - 1, 1),
        set_point=np.full(len(at), np.nan),
        coordinate=np.full(len(at), np.nan),
        arm=arm,
        forming=forming,
        holder=holder[0] + (holder[1] - holder[0]) * at / max(count - 1, 1),
        axis=between(*axis, at / max(count - 1, 1)) if tilts else np.empty((0, 3)),
        axis_arm=axis_arm if tilts else 0.0,
    )


def horizontal_direction(tip_1: Array, tip_2: Array, least: float) -> Array | None:
    """(N,) rad, continuous angle of the direction from one ball centre to the other (Ren 2018 eq. 2-2), from tips.

    Where the centres are less than ``least`` m apart in the plane, d_n is interpolated between its
    neighbours; None when that is so everywhere. The balls' centres lie above their tips, so tips serve as well.
    """
    apart = tip_2[:, :2] - tip_1[:, :2]
    valid = np.linalg.norm(apart, axis=1) >= least
    if not valid.any():
        return None
    angle = np.unwrap(np.arctan2(apart[valid, 1], apart[valid, 0]))
    return np.asarray(np.interp(np.arange(len(apart)), np.flatnonzero(valid), angle))


def _path_coordinate(path: ToolPath) -> Array:
    """(M,) m, path coordinate in which ``feed`` is the largest speed; strictly ascending."""
    step = np.maximum(
        np.linalg.norm(np.diff(path.forming_tip, axis=0), axis=1),
        np.linalg.norm(np.diff(path.support_tip, axis=0), axis=1) / SUPPORT_RATIO,
    )
    step = np.maximum(step, np.abs(np.diff(path.direction)) * path.arm)
    if len(path.holder):
        step = np.maximum(step, np.abs(np.diff(path.holder)) * HOLDER_RATIO)
    if path.axis_arm > 0.0:
        step = np.maximum(step, angle_between(path.axis[:-1], path.axis[1:]) * path.axis_arm)
    return np.concatenate([[0.0], np.cumsum(np.maximum(step, 1e-12))])


def _speed_plan(
    path: ToolPath, position: Array, feed: float, limits: Limits, entry: float, *, runs_on: bool
) -> tuple[Array, Array]:
    """Grid (K,) m along the path and speed (K,) m/s at it; at its ends as in :func:`sample`."""
    spacing = np.diff(position)
    span = feed * (limits.blend_ticks + 2) / limits.rate
    blend = limits.blend_ticks / limits.rate
    arm = path.arm * np.column_stack([np.cos(path.direction), np.sin(path.direction)])
    slope_1 = np.diff(path.forming_tip, axis=0) / spacing[:, None]
    slope_2 = np.diff(path.support_tip, axis=0) / spacing[:, None]
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
    inside = int(np.ceil(span / spacing_grid)) + 1
    if entry > 0.0 and inside < len(grid):  # what lies beyond an end in motion turns as the path does near it
        nearby[:inside] = np.maximum(nearby[:inside], nearby[inside])
    if runs_on and inside < len(grid):
        nearby[-inside:] = np.maximum(nearby[-inside:], nearby[-inside - 1])
    speed = np.minimum(feed, 0.5 * limits.acceleration * blend / np.maximum(nearby, 1e-9))
    if len(path.speed):
        # The averages mix speeds of one blend: the least of them is kept all along it.
        allowed = np.interp(grid, position, path.speed)
        cell = np.minimum((position / spacing_grid).astype(int), len(grid) - 2)
        for k in (0, 1):
            np.minimum.at(allowed, cell + k, path.speed)
        speed = np.minimum(speed, minimum_filter1d(allowed, 2 * inside - 1, mode="nearest"))
    if entry > 0.0:
        speed[:inside] = np.minimum(speed[:inside], entry)
    speed[0] = entry
    if runs_on:
        speed[-inside:] = speed[-inside:].min()  # and below: the path is left at a speed that does not change
    else:
        speed[-1] = 0.0
    acceleration = np.full(len(grid), 0.5 * limits.acceleration / steepest)
    if len(path.axis):
        swing = limits.tilt_lever * np.linalg.norm(np.diff(path.axis, axis=0), axis=1) / spacing
        at_grid = np.clip(np.searchsorted(position, grid, side="right") - 1, 0, len(spacing) - 1)
        acceleration /= 1.0 + swing[at_grid] / steepest
    speed = _reachable(speed, spacing_grid, acceleration)
    if runs_on:
        steady = min(2 * inside, len(grid) - 1)
        speed[-steady:] = np.minimum(speed[-steady:], speed[-steady])
    if entry > speed[0]:  # it comes faster than the path would be entered: it brakes as soon as it can
        braking = entry**2 - 2 * acceleration[0] * (grid - grid[0])
        speed = np.sqrt(np.maximum(speed**2, braking))
    return grid, speed


def _variation(slope: Array) -> Array:
    """(M-2,) size of the change of a direction vector at the inner vertices."""
    return np.asarray(np.linalg.norm(np.diff(slope, axis=0), axis=1))


def _reachable(speed: Array, spacing: float, acceleration: Array) -> Array:
    """Speeds (K,) lowered so that each can be reached from its neighbours with ``acceleration`` (K,)."""
    gain: list[float] = (2 * acceleration * spacing).tolist()
    squares: list[float] = (speed**2).tolist()
    for order in (range(1, len(squares)), range(len(squares) - 2, -1, -1)):
        step = 1 if order.step > 0 else -1
        for i in order:
            reach = squares[i - step] + gain[i]
            squares[i] = min(reach, squares[i])
    return np.sqrt(squares)


def _timed(position: Array, grid: Array, speed: Array, rate: float, *, whole: bool) -> Array:
    """(T,) m, path coordinate at every tick, constant acceleration within each grid interval.

    ``whole``: time is stretched to a whole number of ticks, so that the last step is no shorter than the others.
    """
    duration = 2 * np.diff(grid) / (speed[:-1] + speed[1:])
    start = np.concatenate([[0.0], np.cumsum(duration)])
    time = np.arange(int(np.ceil(start[-1] * rate)) + 1) / rate
    if whole:
        time = time * (start[-1] / time[-1])
    cell = np.clip(np.searchsorted(start, time, side="right") - 1, 0, len(duration) - 1)
    since = np.minimum(time - start[cell], duration[cell])
    acceleration = (speed[1:] - speed[:-1])[cell] / duration[cell]
    travelled = grid[cell] + speed[cell] * since + 0.5 * acceleration * since**2
    travelled[-1] = position[-1]
    return np.asarray(np.clip(travelled, 0.0, position[-1]))


_HELD = [10, 11, 12]
"""Columns of set-point, coordinate and holder: they do not run on beyond the ends of a path."""


def _average(columns: Array, ticks: int, in_motion: tuple[bool, bool] = (False, False)) -> Array:
    """Columns averaged over ``ticks``, extended at rest so that the ends are reached.

    At an end that is ``in_motion`` they run on instead, and the average ends where it is centred on the end: half a
    tick beyond it when ``ticks`` is even, at the end of one path as at the beginning of the next.
    """
    if ticks < 2:
        return columns
    first = np.repeat(columns[:1], ticks, axis=0)
    last = np.repeat(columns[-1:], ticks, axis=0)
    begin, end = 0, 0
    if in_motion[0]:
        first = _run_on(columns[::-1], ticks)[::-1]
        begin = ticks // 2
    if in_motion[1]:
        last = _run_on(columns, ticks)
        end = (ticks + 1) // 2
    reference = columns[0]
    total = np.cumsum(np.concatenate([first, columns, last]) - reference, axis=0)
    averaged = np.asarray(reference + (total[ticks:] - total[:-ticks]) / ticks)
    return averaged[begin : len(averaged) - end]


def _run_on(columns: Array, ticks: int) -> Array:
    """(ticks, C), columns continued beyond their end with their speed and turn there; some are held."""
    near = max(1, min(ticks, (len(columns) - 1) // 2))
    speed = (columns[-1] - columns[-1 - near]) / near
    before = (columns[-1 - near] - columns[-1 - 2 * near]) / near if len(columns) > 2 * near else speed
    change = (speed - before) / near
    k = np.arange(1.0, ticks + 1)[:, None]
    beyond = k * (speed + 0.5 * near * change) + 0.5 * k**2 * change
    beyond[:, _HELD] = 0.0
    return np.asarray(columns[-1] + beyond)


def _speed(forming: Array, support: Array, rate: float, entry: float) -> Array:
    """(T,) m/s, speed of the forming tip, or of the other one where that rests."""
    first = np.linalg.norm(np.diff(forming, axis=0), axis=1)
    second = np.linalg.norm(np.diff(support, axis=0), axis=1)
    return np.concatenate([[entry], np.where(first > 1e-12, first, second) * rate])


def _standstill(path: ToolPath) -> Motion:
    """One tick at the first vertex."""
    normal = np.array([[np.cos(path.direction[0]), np.sin(path.direction[0])]])
    holder = path.holder[-1:] if len(path.holder) else np.zeros(1)
    return Motion(
        path.tip_1[:1],
        path.tip_2[:1],
        normal,
        path.set_point[-1:],
        path.coordinate[-1:],
        np.zeros(1),
        holder,
        path.axis[-1:],
    )
