"""The segments one contour is made of (approach or link, engage, contour, lift, park) and their playback tick by tick.

Frame ``sheet``, SI units; one row per control tick (:class:`Column`), played back at the planned pace or slower.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.tool_axis import UP, UPRIGHT
from isf_core.types import Array

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.motion import tool_moves
from isf_force_ctrl.motion.contour_path import ramped
from isf_force_ctrl.motion.tool_moves import Posture, Tools
from isf_force_ctrl.motion.trajectory import Motion, ToolPath, sample

Row = list[float]

JOIN_LENGTH = 1.0e-3
"""m, largest gap between the end of an open contour and the begin of the next one that continues it; springback
correction moves the one against the other."""


class Column(IntEnum):
    """Where a quantity is in a row; tips and axis take three columns each.

    A row ends before the axis of tool 1 where that tool is upright.
    """

    TIP_1 = 0
    TIP_2 = 3
    NORMAL_X = 6
    NORMAL_Y = 7
    SET_POINT = 8
    COORDINATE = 9
    SPEED = 10
    LEARNED = 11
    HOLDER = 12
    AXIS = 13


RESTING: Row = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, float("nan"), float("nan"), 0.0, 0.0, 0.0]
"""A row in which nothing moves."""


@dataclass(frozen=True)
class Segment:
    """Rows of one mode.

    ``waits``: stay at the only row until the force has settled. ``runs_on``: the last row is passed in motion.
    """

    mode: Mode
    rows: list[Row]
    waits: bool = False
    runs_on: bool = False


@dataclass(frozen=True)
class Present:
    """What the tools are doing when a contour is started.

    Attributes
    ----------
    here : Posture
    tools : Tools of the contour before
    engaged : the support tool is in contact under force control
    clear : the tools are clear of the sheet, so that a long way needs no lift
    normal : (3,) of the sheet where the tools are, for lifting
    velocity : (3,), (3,) m/s of both tips when the last contour was left in motion
    before : path of the contour formed last
    """

    here: Posture
    tools: Tools
    engaged: bool
    clear: bool
    normal: Array
    velocity: tuple[Array, Array] | None = None
    before: ToolPath | None = None


def joins(path: ToolPath, present: Present) -> bool:
    """True when ``path`` begins where the tools are in contact: the next turn of a spiral."""
    here = present.here
    return (
        not present.clear
        and path.forming == present.tools.forming
        and float(np.linalg.norm(path.tip_1[0] - here.tip_1)) <= JOIN_LENGTH
        and float(np.linalg.norm(path.tip_2[0] - here.tip_2)) <= JOIN_LENGTH
    )


def continues(contour: Contour, path: ToolPath, present: Present, farthest: float) -> bool:
    """Does an open ``contour`` go on from the open one before?

    Raises IsfError CONTOUR_NOT_JOINED when it should, but begins more than ``farthest`` m away: the tools would leave
    the sheet in the middle of a spiral.
    """
    if contour.closed or contour.retract:
        return False
    here = present.here
    apart = max(np.linalg.norm(path.tip_1[0] - here.tip_1), np.linalg.norm(path.tip_2[0] - here.tip_2))
    if not present.clear and path.forming == present.tools.forming and apart > farthest:
        raise IsfError(
            ErrorCode.CONTOUR_NOT_JOINED,
            f"is open and begins {1e3 * apart:.1f} mm from the end of the one before",
            where=f"{contour_label(contour.index)} of {contour.plan_id}",
            advice="order the contours, or set retract where the tools are to be lifted",
        )
    return joins(path, present)


def contour_segments(
    config: ControlConfig,
    path: ToolPath,
    feed: float,
    present: Present,
    *,
    retract: bool = False,
    continues: bool = False,
    runs_on: bool = False,
) -> list[Segment]:
    """Segments from where the tools are along ``path``.

    ``retract``: lifted clear before. ``continues``: the path goes on from the contour before and :func:`joins` it.
    ``runs_on``: another one will continue it, so it is left in motion.
    """
    here, clear = present.here, present.clear
    axis = path.axis[0] if len(path.axis) else UP
    start = Posture(path.tip_1[0], path.tip_2[0], float(path.direction[0]), _holder_of(path), axis)
    forced = bool(np.isfinite(path.set_point[0]))
    if present.velocity is not None and continues:
        return _onward(config, path, feed, present, forced=forced, runs_on=runs_on)
    resting = here.tip_2 if path.forming == 1 else here.tip_1
    tools = Tools(path.forming, bool(np.abs(path.support_tip - resting).max() > 1e-9))
    segments: list[Segment] = []
    if present.velocity is not None:
        segments.append(braking(config, present))
        here = posture_of(segments[-1].rows[-1])
    short = None
    if not (clear or retract or path.forming != present.tools.forming):
        short = tool_moves.link(config, here, start, feed, tools)
    if short is not None:
        keep = forced and present.engaged
        set_point = float(path.set_point[0]) if keep else float("nan")
        segments.append(Segment(Mode.ENGAGE if keep else Mode.APPROACH, rows_of(short, set_point)))
    else:
        if not clear:
            lifting = tools if path.forming == present.tools.forming else present.tools
            segments += _segments(Mode.LIFT, tool_moves.lift(config, here, present.normal, lifting))
            if segments:
                here = posture_of(segments[-1].rows[-1])
        path = ramped(path, present.before)
        start = replace(start, tip_1=path.tip_1[0], tip_2=path.tip_2[0])
        moves = tool_moves.approach(config, here, start, feed, tools)
        segments += _segments(Mode.APPROACH, moves)
    motion = sample(path, feed, tool_moves.limits_of(config), runs_on=runs_on)
    rows = rows_of(motion)
    if forced and not (continues and present.engaged):
        wait = list(rows[0])
        wait[Column.COORDINATE] = float("nan")
        if not present.engaged and wait[Column.SET_POINT] > config.engage_force:
            wait[Column.SET_POINT] = config.engage_force
            ticks = _ramp_ticks(config, float(path.set_point[0]) - config.engage_force, len(rows))
            ramp = Segment(Mode.ENGAGE, rows[: ticks + 1], runs_on=True)
            rows = rows[ticks:]
            return [
                *segments,
                Segment(Mode.ENGAGE, [wait], waits=True),
                ramp,
                Segment(Mode.CONTROL, rows, runs_on=runs_on),
            ]
        segments.append(Segment(Mode.ENGAGE, [wait], waits=True))
    segments.append(Segment(Mode.CONTROL if forced else Mode.POSITION, rows, runs_on=runs_on))
    return segments


def _onward(
    config: ControlConfig, path: ToolPath, feed: float, present: Present, *, forced: bool, runs_on: bool
) -> list[Segment]:
    """The next turn of a spiral, entered in motion; what the two ends differ by fades out along its begin."""
    assert present.velocity is not None
    if not len(path.axis) and not np.array_equal(present.here.axis, UP):
        path = replace(path, axis=np.tile(UP, (len(path.tip_1), 1)))  # the turn before was left tilted
    entry = float(np.linalg.norm(present.velocity[path.forming - 1]))
    rows = rows_of(sample(path, feed, tool_moves.limits_of(config), entry=max(entry, 1e-4), runs_on=runs_on))
    _fade_in(config, rows, present, feed)
    if forced and not present.engaged:
        ticks = _ramp_ticks(config, float(path.set_point[0]), len(rows))
        return [
            Segment(Mode.ENGAGE, rows[: ticks + 1], runs_on=True),
            Segment(Mode.CONTROL, rows[ticks:], runs_on=runs_on),
        ]
    return [Segment(Mode.CONTROL if forced else Mode.POSITION, rows, runs_on=runs_on)]


def _ramp_ticks(config: ControlConfig, force: float, count: int) -> int:
    """Ticks in which the set-point rises by ``force`` N and the force settles, on a way of ``count`` ticks."""
    least = force / config.set_point_rate + config.settled_time
    return min(count - 2, int(np.ceil((least + 0.2) * config.rate)))


def _fade_in(config: ControlConfig, rows: list[Row], present: Present, feed: float) -> None:
    """Begin where and as fast as the tools are: what differs fades out with a fifth of feed and acceleration."""
    assert present.velocity is not None
    here = present.here
    columns = [0, 1, 2, 3, 4, 5, int(Column.NORMAL_X), int(Column.NORMAL_Y), int(Column.HOLDER)]
    there = [*here.tip_1, *here.tip_2, np.cos(here.angle), np.sin(here.angle), here.holder]
    if len(rows[0]) > Column.AXIS:
        columns += range(Column.AXIS, Column.AXIS + 3)
        there += here.axis.tolist()
    first, second = (np.array([row[c] for c in columns]) for row in rows[:2])
    apart = np.array(there) - first
    drift = np.zeros(len(columns))
    drift[:6] = np.concatenate(present.velocity) / config.rate - (second - first)[:6]
    largest = float(np.abs(apart[[0, 1, 2, 3, 4, 5, 8]]).max())
    speed = float(np.abs(drift).max()) * config.rate
    time = max(0.15, 9.4 * largest / feed, float(np.sqrt(29.0 * largest / config.acceleration)))
    time = max(time, 15.0 * speed / config.acceleration)
    ticks = min(len(rows) - 1, int(np.ceil(time * config.rate)))
    for k in range(ticks):
        s = k / ticks
        weight = 1.0 - s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        for column, value in zip(columns, (weight * (apart + k * drift)).tolist(), strict=True):
            rows[k][column] += value


def braking(config: ControlConfig, present: Present, mode: Mode = Mode.FREEZE) -> Segment:
    """Straight on and down to rest, for a contour that was left in motion and is not continued."""
    assert present.velocity is not None
    motion = tool_moves.brake(config, present.here, present.velocity, present.tools.forming)
    return Segment(mode, rows_of(motion))


def lift_segments(
    config: ControlConfig,
    here: Posture,
    normal: Array,
    tools: Tools,
    *,
    then: Literal["park", "aside", "stay"] = "park",
) -> list[Segment]:
    """Lift both tools clear, ``then`` park them, move them aside, or leave them at park height over the place."""
    moves = tool_moves.lift(config, here, normal, tools)
    segments = _segments(Mode.LIFT, moves)
    if segments:
        here = posture_of(segments[-1].rows[-1])
    if then == "aside":
        segments += aside_segments(config, here, tools)
    elif then == "park":
        segments += _segments(Mode.LIFT, tool_moves.park(config, here, tools))
    return segments


def aside_segments(config: ControlConfig, here: Posture, tools: Tools) -> list[Segment]:
    """Move both tools, clear of the sheet, aside; nothing where they are there."""
    return _segments(Mode.LIFT, tool_moves.aside(config, here, tools))


def rows_of(motion: Motion, set_point: float | None = None) -> list[Row]:
    """One row per tick; ``set_point`` N replaces the motion's own."""
    wanted = motion.set_point if set_point is None else np.full(len(motion), set_point)
    table = np.column_stack(
        [
            motion.tip_1,
            motion.tip_2,
            motion.normal,
            wanted,
            motion.coordinate,
            motion.speed,
            np.zeros(len(motion)),
            motion.holder,
            *motion.axis.T[: 3 * bool(len(motion.axis))],
        ]
    )
    rows: list[Row] = table.tolist()
    return rows


def posture_of(row: Row) -> Posture:
    """Tips, direction of d_n, height of the blank holder and axis of a row."""
    return Posture(
        np.array(row[Column.TIP_1 : Column.TIP_1 + 3]),
        np.array(row[Column.TIP_2 : Column.TIP_2 + 3]),
        float(np.arctan2(row[Column.NORMAL_Y], row[Column.NORMAL_X])),
        row[Column.HOLDER],
        np.array(axis_of_row(row)),
    )


def axis_of_row(row: Row) -> tuple[float, float, float]:
    """Unit axis of tool 1 of a row."""
    if len(row) <= Column.AXIS:
        return UPRIGHT
    x, y, z = row[Column.AXIS :]
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size)


def _holder_of(path: ToolPath) -> float:
    return float(path.holder[0]) if len(path.holder) else 0.0


def _segments(mode: Mode, moves: list[Motion]) -> list[Segment]:
    return [Segment(mode, rows_of(motion)) for motion in moves]


_SPEED = int(Column.SPEED)

SLOWEST = 0.1
"""Of the largest speed of a segment, below which tools are braked no harder: an axis may turn while the tip is slow."""


class Playback:
    """Where the tools are commanded to be, without offsets: :attr:`row`."""

    def __init__(self, row: Row, acceleration: float, rate: float) -> None:
        self.row = row
        self.feed = 0.0
        """m/s, present speed along the path."""
        self.pace = 1.0
        self.moving = False
        """The path ended in motion: it is to be continued, or braked."""
        self._tail: tuple[Row, Row] = (row, row)
        self._queue: deque[Segment] = deque()
        self._position = 0.0
        self._most = 0.5 * acceleration / rate
        self._pace_step = 1.0
        self._fastest = 1.0

    def __bool__(self) -> bool:
        """True while there is something to play."""
        return bool(self._queue)

    @property
    def segment(self) -> Segment:
        """The present segment."""
        return self._queue[0]

    @property
    def last_row(self) -> Row:
        """Where all that is queued will end."""
        return self._queue[-1].rows[-1] if self._queue else self.row

    def velocity(self, rate: float) -> tuple[Array, Array]:
        """(3,), (3,) m/s of both tips at the end of a path that ended in motion; ``rate`` Hz."""
        before, end = self._tail
        step = self.pace * rate * (np.array(end[:6]) - np.array(before[:6]))
        return step[:3], step[3:]

    def load(self, segments: list[Segment]) -> None:
        """Append segments; the first one begins when nothing was playing."""
        idle = not self._queue
        self._queue.extend(segments)
        self.moving = False
        if idle and segments:
            self._begin()

    def leave(self) -> Segment:
        """End the present segment, begin the next one if there is one; returns the ended one."""
        done = self._queue.popleft()
        if done.runs_on and len(done.rows) > 1:
            self._tail = (done.rows[-2], done.rows[-1])
        if self._queue:
            self._begin(keep_pace=done.runs_on)
        else:
            self.moving = done.runs_on
        if not done.runs_on:
            self.feed = 0.0
        return done

    def clear(self, *, in_motion: bool = False) -> None:
        """Forget the rest, standing where we are; ``in_motion``: the end of a segment that runs on was reached."""
        if in_motion:
            self.leave()
            self._queue.clear()
            self.moving = True
            return
        self._queue.clear()
        self.moving = False
        self.feed, self.pace = 0.0, 1.0

    def advance(self, wanted_pace: float) -> bool:
        """Move on by one tick; True when the end of the segment is reached."""
        step = self._pace_step
        if wanted_pace <= 0.0:  # the slower the tools are, the sooner they can stand
            step /= max(self.row[_SPEED] / self._fastest, SLOWEST)
        self.pace += min(max(wanted_pace - self.pace, -step), step)
        rows = self._queue[0].rows
        position = self._position + self.pace
        if position >= len(rows) - 1:
            excess = position - (len(rows) - 1)
            self.row = rows[-1]
            if excess > 0.0 and self._queue[0].runs_on and len(rows) > 1:
                self.row = [b + (b - a) * excess for a, b in zip(rows[-2], rows[-1], strict=True)]
            return True
        self._position = position
        index = int(position)
        part = position - index
        row = rows[index]
        if part > 0.0:
            row = [a + (b - a) * part for a, b in zip(row, rows[index + 1], strict=True)]
        self.row = row
        self.feed = row[_SPEED] * self.pace
        return False

    def _begin(self, *, keep_pace: bool = False) -> None:
        rows = self._queue[0].rows
        self.row = rows[0]
        self._position = 0.0
        if not keep_pace:
            self.pace = 1.0
        self._fastest = max(max(row[_SPEED] for row in rows), 1e-3)
        self._pace_step = self._most / self._fastest
