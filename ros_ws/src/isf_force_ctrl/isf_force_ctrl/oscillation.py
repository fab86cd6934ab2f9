"""Watch over the force loop at run time: an oscillation lowers its gain, and calm lets it rise again.

The gain is right for the contact stiffness of the rig file; a contact more than about three times stiffer makes the
loop oscillate at 10-20 Hz (Ren 2018, section 2.3.3). That shows as a row of swings of the filtered force error, each
larger than ``swing`` and shorter than half the longest period. Corners and noise do not swing so often in a row.
"""

from __future__ import annotations

BACKOFF = 0.6
"""Factor on the gain each time an oscillation is found."""

LEAST_SCALE = 0.15
"""Smallest factor on the gain."""

SWINGS = 6
"""Half periods in a row that make an oscillation."""

LONGEST_PERIOD = 0.2
"""s, longest period that counts: the loop's own are 0.05-0.1 s."""

QUIET_TIME = 2.0
"""s without oscillation before the gain rises again."""

CEILING = 0.8
"""Share of the factor that oscillated up to which the gain rises soon."""

CEILING_TIME = 60.0
"""s in which that ceiling rises by a factor of e: the contact may have changed."""

RECOVERY_TIME = 2.0
"""s in which the gain rises by a factor of e."""


class OscillationMonitor:
    """Factor on the gain of one force loop; one call per tick.

    ``swing`` N is the least size of a half period, peak to peak.
    """

    __slots__ = (
        "_age",
        "_ceiling",
        "_count",
        "_extreme",
        "_half",
        "_quiet",
        "_rate",
        "_rising",
        "_since",
        "_swing",
        "found",
        "scale",
    )

    def __init__(self, rate: float, swing: float) -> None:
        self._rate = rate
        self._swing = swing
        self._half = 0.5 * LONGEST_PERIOD * rate
        self._rising = True
        self._extreme = 0.0
        self._age = 0
        self._count = 0
        self._since = 0
        self._quiet = QUIET_TIME * rate
        self._ceiling = 1.0
        self.scale = 1.0
        """Factor on the gain, LEAST_SCALE..1."""
        self.found = 0
        """Oscillations so far."""

    def step(self, error: float) -> float:
        """Factor after one tick with the filtered force ``error`` (N)."""
        self._age += 1
        beyond = error > self._extreme if self._rising else error < self._extreme
        if beyond:
            self._extreme = error
        elif abs(error - self._extreme) > self._swing:
            self._turn(error)
        if self.scale < 1.0:
            self._since += 1
            if self._since > self._quiet:
                self._ceiling = min(1.0, self._ceiling * (1.0 + 1.0 / (CEILING_TIME * self._rate)))
                self.scale = min(self._ceiling, self.scale * (1.0 + 1.0 / (RECOVERY_TIME * self._rate)))
        return self.scale

    def _turn(self, error: float) -> None:
        """A half period is over."""
        self._count = self._count + 1 if self._age <= self._half else 1
        self._rising, self._extreme, self._age = not self._rising, error, 0
        if self._count < SWINGS:
            return
        self._count = 0
        self.found += 1
        self._ceiling = CEILING * self.scale
        self._since = 0
        self.scale = max(LEAST_SCALE, BACKOFF * self.scale)
