"""Targets as velocities, for drivers that follow a twist: what the trajectory does, and a pull back onto it.

A velocity alone drifts away from the path, by rounding, lost messages and a driver's own errors. So the velocity of
the trajectory is led on, and the distance from the measured tip to the target is taken back in proportion, limited:

    v = (target_n - target_(n-1)) / T + limited(pull (target_(n-1) - measured))
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Vector = tuple[float, float, float]

PULL = 5.0
"""1/s. Assumed: slow against a servo of 30 Hz, so that its lag is no oscillation, and fast against drift."""

MOST_PULL = 0.01
"""m/s, most that the pull adds."""


class TargetTwist:
    """Velocity (3,) m/s of one tool from its targets (3,) m, one per period of 1 / ``rate`` s, and its measured tip."""

    def __init__(self, start: Vector, rate: float) -> None:
        """``start``: where the tool is, m."""
        self._last, self._rate = start, rate
        self.measured: Sequence[float] = start
        """(3,) m, newest measured tip."""

    def step(self, target: Vector) -> Vector:
        """Velocity to be at ``target`` at the end of this period."""
        last, measured, rate = self._last, self.measured, self._rate
        x, y, z = (PULL * (last[k] - measured[k]) for k in range(3))
        size = math.sqrt(x * x + y * y + z * z)
        share = MOST_PULL / size if size > MOST_PULL else 1.0
        self._last = target
        return (
            rate * (target[0] - last[0]) + share * x,
            rate * (target[1] - last[1]) + share * y,
            rate * (target[2] - last[2]) + share * z,
        )
