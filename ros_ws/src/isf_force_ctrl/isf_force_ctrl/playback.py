"""Plays back segments tick by tick, at the planned pace or slower.

The pace scales the time of the plan: 1 as planned, 0 standing. It changes no faster than half the acceleration
limit allows, so slowing down, stopping and going on are smooth anywhere on a path.
"""

from __future__ import annotations

from collections import deque

from isf_force_ctrl.segments import Column, Row, Segment

_SPEED = int(Column.SPEED)


class Playback:
    """Where the tools are commanded to be, without offsets: :attr:`row`."""

    def __init__(self, row: Row, acceleration: float, rate: float) -> None:
        self.row = row
        self.feed = 0.0
        """m/s, present speed along the path."""
        self.pace = 1.0
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

    def load(self, segments: list[Segment]) -> None:
        """Append segments; the first one begins when nothing was playing."""
        idle = not self._queue
        self._queue.extend(segments)
        if idle and segments:
            self._begin()

    def leave(self) -> Segment:
        """End the present segment, begin the next one if there is one; returns the ended one."""
        done = self._queue.popleft()
        self.feed = 0.0
        if self._queue:
            self._begin()
        return done

    def clear(self) -> None:
        """Forget the rest, standing where we are."""
        self._queue.clear()
        self.feed, self.pace = 0.0, 1.0

    def advance(self, wanted_pace: float) -> bool:
        """Move on by one tick; True when the end of the segment is reached."""
        self.pace += min(max(wanted_pace - self.pace, -self._pace_step), self._pace_step)
        rows = self._queue[0].rows
        position = self._position + self.pace
        if position >= len(rows) - 1:
            self.row = rows[-1]
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

    def _begin(self) -> None:
        rows = self._queue[0].rows
        self.row = rows[0]
        self._position, self.pace = 0.0, 1.0
        self._pace_step = self._most / max(max(row[_SPEED] for row in rows), 1e-3)
