"""Contact-force control of the support tool by an offset along the horizontal normal (Ren 2018, section 2.3).

The law is integral only, G_f = K_i / s with K_i = loop_gain / K_c (eq. 2-10, 2-11; loop_gain = 24 1/s there):
low-pass by nature and exact at rest for any contact stiffness. Every tick, in the order of the published listing::

    error -> clamp -> slew limit -> FIR -> soft dead zone -> integrate -> clamp of the offset

The listing holds its error in um at 2 um/N; here it is in N, and limits per update became limits per second. The hold
and smoothing between ticks is the machine's servo. A positive offset moves the support tool towards
the forming tool. Freezing and ramping back go through the same chain, so neither the offset nor its rate can jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isf_force_ctrl.control_state import Flag
from isf_force_ctrl.load_cell_filter import Fir


@dataclass(frozen=True)
class ContactForceSettings:
    """Law and limits at one rate.

    Attributes
    ----------
    rate : Hz, ticks per second
    integral_gain : m/(N s), K_i
    coefficients : FIR on the error
    error_clamp : N, largest error that acts
    error_slew : N/s, fastest change of the acting error
    dead_zone : N, soft: subtracted from larger errors
    offset_limit : m, largest offset (anti-windup: the integrator itself is clamped)
    ramp_back_time : s, time constant with which an offset is taken back
    """

    rate: float
    integral_gain: float
    coefficients: NDArray[np.float64]
    error_clamp: float
    error_slew: float
    dead_zone: float
    offset_limit: float
    ramp_back_time: float


class ContactForceLoop:
    """The integral law with its limiters; one call per tick."""

    __slots__ = (
        "_clamp",
        "_dead",
        "_error",
        "_fir",
        "_gain",
        "_limit",
        "_ramp_back",
        "_rate",
        "_slew",
        "flags",
        "offset",
    )

    def __init__(self, settings: ContactForceSettings) -> None:
        self._clamp = settings.error_clamp
        self._slew = settings.error_slew / settings.rate
        self._dead = settings.dead_zone
        self._limit = settings.offset_limit
        self._rate = settings.rate
        self._gain = settings.integral_gain / settings.rate
        self._ramp_back = 1.0 / (settings.integral_gain * settings.ramp_back_time)
        self._fir = Fir(settings.coefficients)
        self._error = 0.0
        self.offset = 0.0
        """m, present offset along the horizontal normal, positive towards the forming tool."""
        self.flags = 0
        """Limits that were active in the last tick, a sum of :class:`Flag`."""

    def set_gain(self, integral_gain: float) -> None:
        """New K_i (m/(N s)); the offset goes on from where it is."""
        self._gain = integral_gain / self._rate

    def control(self, error: float, advance: float = 0.0) -> float:
        """Offset (m) after one tick with force error ``error`` = set-point - measured (N).

        ``advance`` m is a change of the offset that is known beforehand (feed-forward).
        """
        return self._step(error, self._dead, advance)

    def freeze(self) -> float:
        """Offset (m) after one tick in which it is brought to rest."""
        return self._step(0.0, 0.0, 0.0)

    def ramp_back(self) -> float:
        """Offset (m) after one tick of taking it back to zero."""
        return self._step(-self.offset * self._ramp_back, 0.0, 0.0)

    def _step(self, error: float, dead: float, advance: float) -> float:
        flags = 0
        if error > self._clamp:
            error, flags = self._clamp, int(Flag.SATURATED_ERROR)
        elif error < -self._clamp:
            error, flags = -self._clamp, int(Flag.SATURATED_ERROR)
        change = error - self._error
        if change > self._slew:
            error, flags = self._error + self._slew, flags | int(Flag.SATURATED_RATE)
        elif change < -self._slew:
            error, flags = self._error - self._slew, flags | int(Flag.SATURATED_RATE)
        self._error = error
        filtered = self._fir.step(error)
        if filtered > dead:
            advance += self._gain * (filtered - dead)
        elif filtered < -dead:
            advance += self._gain * (filtered + dead)
        offset = self.offset + advance
        if offset > self._limit:
            offset, flags = self._limit, flags | int(Flag.SATURATED_OFFSET)
        elif offset < -self._limit:
            offset, flags = -self._limit, flags | int(Flag.SATURATED_OFFSET)
        self.offset = offset
        self.flags = flags
        return offset
