"""Contact-force loop of the support tool, compliance compensation of the forming tool, and the filter of both.

Ren 2018, section 2.3 (force loop by an offset along the horizontal normal), section 2.3.1 and eq. 2-12 (compliance in
the sheet plane), section 2.3.4 (low-pass FIR of the load cells). N, m, frame ``sheet``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from operator import mul

import numpy as np
from numpy.typing import NDArray

from isf_force_ctrl.control_state import Flag


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
        self._fir = Fir(settings.coefficients)
        self.retune(settings)
        self._error = 0.0
        self.offset = 0.0
        """m, present offset along the horizontal normal, positive towards the forming tool."""
        self.flags = 0
        """Limits that were active in the last tick, a sum of :class:`Flag`."""

    def retune(self, settings: ContactForceSettings) -> None:
        """Other settings at the same rate; the offset, an integral, goes on from where it is."""
        self._clamp = settings.error_clamp
        self._slew = settings.error_slew / settings.rate
        self._dead = settings.dead_zone
        self._limit = settings.offset_limit
        self._rate = settings.rate
        self._gain = settings.integral_gain / settings.rate
        self._ramp_back = 1.0 / (settings.integral_gain * settings.ramp_back_time)
        self._fir.retune(settings.coefficients)

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


@dataclass(frozen=True)
class ComplianceSettings:
    """Gain and limits at one rate.

    Attributes
    ----------
    rate : Hz
    gain : (2,) m/N, factor times tool compliance in x and y
    coefficients : FIR, after the limiters so that the rate of the offset cannot jump
    offset_slew : m/s, fastest change of the offset
    offset_limit : m, largest offset per axis
    smoothing_time : s, time constant of the first-order low-pass on the force; 0 = none
    """

    rate: float
    gain: tuple[float, float]
    coefficients: NDArray[np.float64]
    offset_slew: float
    offset_limit: float
    smoothing_time: float = 0.0


class ComplianceCompensation:
    """Offset of the forming tool in x and y; one call per tick."""

    z = 0.0
    """m, there is none: axes of a gantry are stiff in z (Ren 2018, 2.2.1)."""

    __slots__ = (
        "_fir_x",
        "_fir_y",
        "_gain_x",
        "_gain_y",
        "_limit",
        "_raw_x",
        "_raw_y",
        "_share",
        "_slew",
        "_slow_across",
        "_slow_along",
        "flags",
        "x",
        "y",
    )

    def __init__(self, settings: ComplianceSettings) -> None:
        self._fir_x, self._fir_y = Fir(settings.coefficients), Fir(settings.coefficients)
        self.retune(settings)
        self._slow_along = self._slow_across = 0.0
        self._raw_x = self._raw_y = 0.0
        self.x = self.y = 0.0
        """m, present offset."""
        self.flags = 0

    def retune(self, settings: ComplianceSettings) -> None:
        """Other settings at the same rate; the offset goes on from where it is, no faster than its slew."""
        self._gain_x, self._gain_y = settings.gain
        self._slew = settings.offset_slew / settings.rate
        self._limit = settings.offset_limit
        self._share = 1.0 / (1.0 + settings.smoothing_time * settings.rate)
        self._fir_x.retune(settings.coefficients)
        self._fir_y.retune(settings.coefficients)

    def step(self, force_x: float, force_y: float, normal_x: float = 1.0, normal_y: float = 0.0) -> None:
        """Take in the force of the sheet on the tool (N) of one tick; ``normal`` is the unit vector it turns with."""
        along = force_x * normal_x + force_y * normal_y
        across = force_y * normal_x - force_x * normal_y
        self._slow_along += self._share * (along - self._slow_along)
        self._slow_across += self._share * (across - self._slow_across)
        wanted_x = -self._gain_x * (self._slow_along * normal_x - self._slow_across * normal_y)
        wanted_y = -self._gain_y * (self._slow_along * normal_y + self._slow_across * normal_x)
        raw_x = limited(wanted_x, self._raw_x, self._slew, self._limit)
        raw_y = limited(wanted_y, self._raw_y, self._slew, self._limit)
        self.flags = 0 if raw_x == wanted_x and raw_y == wanted_y else int(Flag.SATURATED_COMPLIANCE)
        self._raw_x, self._raw_y = raw_x, raw_y
        self.x, self.y = self._fir_x.step(raw_x), self._fir_y.step(raw_y)

    def freeze(self) -> None:
        """Bring the offset to rest where it is."""
        self.flags = 0
        self.x, self.y = self._fir_x.step(self._raw_x), self._fir_y.step(self._raw_y)


def limited(wanted: float, last: float, slew: float, limit: float) -> float:
    """``wanted``, no farther than ``slew`` from ``last`` and ``limit`` from zero."""
    value = limit if wanted > limit else -limit if wanted < -limit else wanted
    if value > last + slew:
        return last + slew
    if value < last - slew:
        return last - slew
    return value


ORIGINAL_TAPS = 4
ORIGINAL_RATE = 440.0
"""Hz, update rate for which the original filter has four taps."""


def taps_for(rate: float) -> int:
    """Number of taps with the duration of the original filter at ``rate`` (Hz), 3 or more."""
    return max(3, round(ORIGINAL_TAPS * rate / ORIGINAL_RATE))


def low_pass(cutoff: float, rate: float, taps: int | None = None) -> NDArray[np.float64]:
    """(taps,) coefficients of a Hamming-window low-pass with unit gain at 0 Hz.

    ``cutoff`` Hz and ``rate`` Hz; ``taps`` defaults to :func:`taps_for`. ValueError when the cut-off is not
    below half the rate.
    """
    from scipy.signal import firwin  # late: 0.3 s that nodes need not pay at their start

    return np.asarray(firwin(taps or taps_for(rate), cutoff, fs=rate))


def group_delay(taps: int, rate: float) -> float:
    """s, delay of a symmetric FIR."""
    return (taps - 1) / 2.0 / rate


class Fir:
    """A FIR filter fed one sample per tick; starts from rest at ``initial``."""

    __slots__ = ("_coefficients", "_history")

    def __init__(self, coefficients: NDArray[np.float64], initial: float = 0.0) -> None:
        self._coefficients = [float(c) for c in coefficients]
        self._history = deque([initial] * len(self._coefficients), maxlen=len(self._coefficients))

    def step(self, value: float) -> float:
        """Filtered value after taking in ``value``."""
        self._history.appendleft(value)
        return float(sum(map(mul, self._coefficients, self._history)))

    def retune(self, coefficients: NDArray[np.float64]) -> None:
        """Other coefficients, as many as before. What came before is kept: two symmetric filters of one length delay
        alike, so a steady or a steadily rising signal goes through the change without a step."""
        self._coefficients = [float(c) for c in coefficients]

    def reset(self, value: float) -> None:
        """Forget the past as if the input had always been ``value``."""
        self._history.extend([value] * len(self._coefficients))
