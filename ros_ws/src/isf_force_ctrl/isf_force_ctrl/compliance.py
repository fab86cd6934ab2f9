"""Compliance compensation of the forming tool in the sheet plane (Ren 2018, section 2.3.1 and eq. 2-12).

The tool gives way by C F; the command is moved by the opposite amount, so that the tip is where it was planned::

    offset = - factor * C_xy * F_forming          (F: force of the sheet on the tool)

Z is left alone: that axis is ten times stiffer. The feedback is positive; it is stable only while K_p K_c < 1
(K_p = factor * C), see :mod:`isf_force_ctrl.stability`. A compensated tool is a stiffer contact, K_c / (1 - K_p K_c),
for whatever disturbs the gap. So the compensation is slow (first-order, ``smoothing_time``): it cancels the mean
deflection, which shows in the part, and leaves the fast, small rest as compliance, on which the force loop lives.

What is slow is the force along and across the horizontal normal d_n, not along x and y: around a contour the force
turns with d_n, and a slow offset in x and y would lag behind it by atan(w T), w rad/s of the turn and T the time
constant: 31 deg on a ring of 10 mm at 30 mm/s and 0.2 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isf_force_ctrl.control_state import Flag
from isf_force_ctrl.load_cell_filter import Fir


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
        self._gain_x, self._gain_y = settings.gain
        self._slew = settings.offset_slew / settings.rate
        self._limit = settings.offset_limit
        self._fir_x, self._fir_y = Fir(settings.coefficients), Fir(settings.coefficients)
        self._share = 1.0 / (1.0 + settings.smoothing_time * settings.rate)
        self._slow_along = self._slow_across = 0.0
        self._raw_x = self._raw_y = 0.0
        self.x = self.y = 0.0
        """m, present offset."""
        self.flags = 0

    def step(self, force_x: float, force_y: float, normal_x: float = 1.0, normal_y: float = 0.0) -> None:
        """Take in the force of the sheet on the tool (N) of one tick; ``normal`` is the unit vector it turns with."""
        along = force_x * normal_x + force_y * normal_y
        across = force_y * normal_x - force_x * normal_y
        self._slow_along += self._share * (along - self._slow_along)
        self._slow_across += self._share * (across - self._slow_across)
        wanted_x = -self._gain_x * (self._slow_along * normal_x - self._slow_across * normal_y)
        wanted_y = -self._gain_y * (self._slow_along * normal_y + self._slow_across * normal_x)
        raw_x = _limited(wanted_x, self._raw_x, self._slew, self._limit)
        raw_y = _limited(wanted_y, self._raw_y, self._slew, self._limit)
        self.flags = 0 if raw_x == wanted_x and raw_y == wanted_y else int(Flag.SATURATED_COMPLIANCE)
        self._raw_x, self._raw_y = raw_x, raw_y
        self.x, self.y = self._fir_x.step(raw_x), self._fir_y.step(raw_y)

    def freeze(self) -> None:
        """Bring the offset to rest where it is."""
        self.flags = 0
        self.x, self.y = self._fir_x.step(self._raw_x), self._fir_y.step(self._raw_y)


def _limited(wanted: float, last: float, slew: float, limit: float) -> float:
    value = limit if wanted > limit else -limit if wanted < -limit else wanted
    if value > last + slew:
        return last + slew
    if value < last - slew:
        return last - slew
    return value
