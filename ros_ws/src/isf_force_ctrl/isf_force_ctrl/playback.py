"""Plays back segments tick by tick, at the planned pace or slower.

The pace scales the time of the plan: 1 as planned, 0 standing. It changes no faster than half the acceleration
limit allows, so slowing down, stopping and going on are smooth anywhere on a path.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from isf_force_ctrl.segments import Column, Row, Segment

Array = NDArray[np.float64]

_SPEED = int(Column.SPEED)


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
        self.pace += min(max(wanted_pace - self.pace, -self._pace_step), self._pace_step)
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
        self._pace_step = self._most / max(max(row[_SPEED] for row in rows), 1e-3)
