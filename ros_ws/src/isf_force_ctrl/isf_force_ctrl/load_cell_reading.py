"""From raw readings of a load cell to the wrench that force control uses, for a cell's own driver.

Calibration matrix, tare, weight of what hangs below the cell (by its orientation), rotation into frame ``sheet``, FIR
low-pass, and a watch over drift, saturation and lost or frozen signals. SI units; forces as the sheet does to the tool.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

from isf_force_ctrl.load_cell_filter import Fir, low_pass

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.80665])
"""m/s^2 in frame sheet."""


@dataclass(frozen=True)
class CellSettings:
    """What is known of one cell.

    Attributes
    ----------
    rate : Hz ; cutoff : Hz of the low-pass, 0 = none ; taps : of the FIR, None = as in force control
    matrix : (3, C) N per unit of the readings
    rotation : (3, 3) from axes of the cell to frame sheet
    mass : kg of tool and holder below the cell
    range : (C,) largest reading; beyond 99 % of it a channel counts as saturated
    frozen_after : readings in a row, all the same, that count as a frozen signal
    drift_limit : N, change of the unloaded force since the tare from which a new tare is asked for
    """

    rate: float
    matrix: Array
    rotation: Array
    range: Array
    cutoff: float = 40.0
    taps: int | None = None
    mass: float = 0.0
    frozen_after: int = 50
    drift_limit: float = 10.0


@dataclass
class CellReading:
    """One cell, reading by reading."""

    settings: CellSettings
    zero: Array = field(init=False)
    drift: float = field(init=False, default=0.0)
    """N, unloaded force at the last call of :meth:`watch_drift`."""

    def __post_init__(self) -> None:
        s = self.settings
        self.zero = np.zeros(np.shape(s.matrix)[1])
        self._tared = False
        coefficients = low_pass(s.cutoff, s.rate, s.taps) if s.cutoff > 0.0 else np.array([1.0])
        self._filters = [Fir(coefficients) for _ in range(3)]
        self._last, self._same = np.full(len(self.zero), np.nan), 0

    def tare(self, readings: Array, rotation: Array | None = None) -> None:
        """Zero from ``readings`` (n, C) without contact; the weight is not part of it, so the cell may be turned later.

        Raises IsfError WRENCH_NOT_FINITE, NO_TARE (the tool is being touched: the readings are not steady).
        """
        readings = np.atleast_2d(np.asarray(readings, dtype=float))
        if not np.isfinite(readings).all():
            raise IsfError(ErrorCode.WRENCH_NOT_FINITE, "a reading is not finite", advice="check the cable of the cell")
        spread = float(np.abs((readings - readings.mean(axis=0)) @ self.settings.matrix.T).max())
        if spread > 0.5 * self.settings.drift_limit + 5.0:
            raise IsfError(
                ErrorCode.NO_TARE,
                f"the force changes by {spread:.0f} N while it is tared",
                advice="move the tools clear",
            )
        weight = np.linalg.pinv(self.settings.matrix) @ self._weight(rotation)
        self.zero = readings.mean(axis=0) - weight
        self._tared = True

    def force(self, reading: Array, rotation: Array | None = None) -> Array:
        """(3,) N on the tool in frame sheet, filtered, from ``reading`` (C,); ``rotation`` (3, 3) as in the settings.

        Raises IsfError NO_TARE, WRENCH_NOT_FINITE, WRENCH_OUT_OF_RANGE (saturated), WRENCH_LOST (frozen).
        """
        s, reading = self.settings, np.asarray(reading, dtype=float)
        if not self._tared:
            raise IsfError(ErrorCode.NO_TARE, "the load cell was not tared", advice="tare it with the tools free")
        if not np.isfinite(reading).all():
            raise IsfError(ErrorCode.WRENCH_NOT_FINITE, "a reading is not finite", advice="check the cable of the cell")
        beyond = np.abs(reading) >= 0.99 * s.range
        if beyond.any():
            raise IsfError(
                ErrorCode.WRENCH_OUT_OF_RANGE,
                f"channel {int(np.argmax(beyond)) + 1} of the load cell is at the end of its range",
                advice="reduce the load, or use a cell with a larger range",
            )
        self._same = self._same + 1 if np.array_equal(reading, self._last) else 0
        self._last = reading
        if self._same >= s.frozen_after:
            raise IsfError(ErrorCode.WRENCH_LOST, f"the reading has been the same {self._same} times: frozen signal")
        turn = s.rotation if rotation is None else rotation
        force = turn @ (s.matrix @ (reading - self.zero) - self._weight(rotation))
        return np.array([fir.step(float(value)) for fir, value in zip(self._filters, force, strict=True)])

    def watch_drift(self, readings: Array, rotation: Array | None = None) -> float:
        """N, change of the unloaded force since the tare, from ``readings`` (n, C) without contact.

        Raises IsfError NO_TARE when it is beyond the limit.
        """
        mean = np.atleast_2d(np.asarray(readings, dtype=float)).mean(axis=0)
        self.drift = float(np.linalg.norm(self.settings.matrix @ (mean - self.zero) - self._weight(rotation)))
        if self.drift > self.settings.drift_limit:
            raise IsfError(
                ErrorCode.NO_TARE,
                f"the load cell has drifted by {self.drift:.1f} N",
                advice="tare it again, tools free",
            )
        return self.drift

    def _weight(self, rotation: Array | None) -> Array:
        """(3,) N in axes of the cell: tool and holder pull at it."""
        turn = self.settings.rotation if rotation is None else rotation
        return np.asarray(turn.T @ (self.settings.mass * GRAVITY))
