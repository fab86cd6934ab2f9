"""A straight way travelled from rest to rest, which may be ended anywhere: its end is not known beforehand."""

from __future__ import annotations

import math

_BRAKING = 0.8
"""Share of the acceleration that braking is planned with: it begins one tick late."""


class Glide:
    """Position along a way of ``length`` m at no more than ``speed`` m/s; one call per tick of ``rate`` Hz."""

    def __init__(self, length: float, speed: float, acceleration: float, rate: float) -> None:
        self._length, self._speed = length, speed
        self._step, self._period = acceleration / rate, 1.0 / rate
        self._braking = 2.0 * _BRAKING * acceleration
        self._velocity = 0.0
        self._stopping = False
        self.position = 0.0
        """m from the begin."""

    @property
    def at_rest(self) -> bool:
        """True at the end of the way, and once it was stopped."""
        return self.position >= self._length or (self._stopping and self._velocity <= 0.0)

    def stop(self) -> None:
        """Come to rest as soon as possible."""
        self._stopping = True

    def step(self) -> float:
        """m, position after one tick."""
        left = self._length - self.position
        wanted = 0.0 if self._stopping else min(self._speed, math.sqrt(self._braking * max(left, 0.0)))
        change = min(max(wanted - self._velocity, -self._step), self._step)
        self._velocity = max(0.0, self._velocity + change)
        if not self._stopping and self._velocity <= 0.0:
            self._velocity = self._step
        moved = self._velocity * self._period
        # the last tick goes to the very end: returning must not leave a rest
        self.position = self._length if moved >= left - 1e-9 else self.position + moved
        return self.position
