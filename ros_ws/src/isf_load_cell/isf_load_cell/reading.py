"""From raw readings of a load cell to the wrench that force control uses.

Calibration matrix, tare, weight of what hangs below the cell (by its orientation), rotation into frame ``sheet``, FIR
low-pass, and a watch over drift, saturation and lost or frozen signals. SI units; forces as the sheet does to the tool,
torques about the origin of the cell. Node ``load_cell`` runs it; a driver of one's own may as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_force_ctrl.laws.force_and_compliance import Fir, low_pass
from isf_force_ctrl.supervision.wrench_watch import check_drift

IN_LOCKSTEP = "a machine in lockstep that waits has no new readings: machine/tare lets time pass for them"
"""Advice where readings are the same, or too few."""

GRAVITY = np.array([0.0, 0.0, -9.80665])
"""m/s^2 in frame sheet."""


@dataclass(frozen=True)
class CellSettings:
    """What is known of one cell.

    Attributes
    ----------
    rate : Hz ; cutoff : Hz of the low-pass, 0 = none ; taps : of the FIR, None = as in force control
    matrix : (3, C) N per unit of the readings, or (6, C) N and N m
    rotation : (3, 3) from axes of the cell to frame sheet
    mass : kg of tool and holder below the cell ; centre : (3,) m from the cell to its centre, in axes of the cell
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
    centre: Array = field(default_factory=lambda: np.zeros(3))
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
        self._filters = [Fir(coefficients) for _ in range(6)]
        self._last, self._same = np.full(len(self.zero), np.nan), 0

    def tare(self, readings: Array, rotation: Array | None = None) -> None:
        """Zero from ``readings`` (n, C) without contact; the weight is not part of it, so the cell may be turned later.

        Raises IsfError WRENCH_NOT_FINITE, WRENCH_OUT_OF_RANGE (saturated), WRENCH_FROZEN, NO_TARE (the tool is being
        touched: readings are not steady).
        """
        readings = np.atleast_2d(np.asarray(readings, dtype=float))
        if not np.isfinite(readings).all():
            raise IsfError(ErrorCode.WRENCH_NOT_FINITE, "a reading is not finite", advice="check the cable of the cell")
        self._check_range(readings)
        if len(readings) > self.settings.frozen_after and (readings == readings[0]).all():
            what = f"{len(readings)} readings are all the same: frozen signal"
            raise IsfError(ErrorCode.WRENCH_FROZEN, what, advice=f"check the load cell's driver; {IN_LOCKSTEP}")
        check_steady((readings - readings.mean(axis=0)) @ self.settings.matrix[:3].T, self.settings.drift_limit)
        weight = np.linalg.pinv(self.settings.matrix) @ self._weight(rotation)
        self.zero = readings.mean(axis=0) - weight
        self._tared = True
        self._last, self._same = np.full(len(self.zero), np.nan), 0  # a signal that was frozen is looked at anew
        for fir in self._filters:
            fir.reset(0.0)

    def force(self, reading: Array, rotation: Array | None = None) -> Array:
        """(3,) N on the tool in frame sheet: the forces of :meth:`wrench`."""
        return self.wrench(reading, rotation)[:3]

    def wrench(self, reading: Array, rotation: Array | None = None) -> Array:
        """(6,) N and N m on the tool in axes of frame sheet, filtered, from ``reading`` (C,).

        ``rotation`` (3, 3) as in the settings, where it changes. Torques are zero when the matrix has three rows.
        Raises IsfError NO_TARE, WRENCH_NOT_FINITE, WRENCH_OUT_OF_RANGE (saturated), WRENCH_FROZEN.
        """
        s, reading = self.settings, np.asarray(reading, dtype=float)
        if not self._tared:
            raise IsfError(ErrorCode.NO_TARE, "the load cell was not tared", advice="tare it with the tools free")
        if not np.isfinite(reading).all():
            raise IsfError(ErrorCode.WRENCH_NOT_FINITE, "a reading is not finite", advice="check the cable of the cell")
        self._check_range(reading)
        self._same = self._same + 1 if np.array_equal(reading, self._last) else 0
        self._last = reading
        if self._same >= s.frozen_after:
            raise IsfError(
                ErrorCode.WRENCH_FROZEN,
                f"the reading has been the same {self._same} times: frozen signal",
                advice="check the load cell's driver",
            )
        turn = s.rotation if rotation is None else rotation
        load = s.matrix @ (reading - self.zero) - self._weight(rotation)
        wrench = np.zeros(6)
        wrench[: len(load)] = np.concatenate([turn @ part for part in np.split(load, len(load) // 3)])
        return np.array([fir.step(float(value)) for fir, value in zip(self._filters, wrench, strict=True)])

    def warning(self) -> IsfError | None:
        """What a person should look at though the wrench is right: nothing, one cell has no redundancy."""
        return None

    def take_news(self) -> list[IsfError]:
        """What was lost though the wrench is right: nothing."""
        return []

    def watch_drift(self, readings: Array, rotation: Array | None = None) -> float:
        """N, change of the unloaded force since the tare, from ``readings`` (n, C) without contact.

        Raises IsfError NO_TARE when it is beyond the limit.
        """
        mean = np.atleast_2d(np.asarray(readings, dtype=float)).mean(axis=0)
        load = self.settings.matrix @ (mean - self.zero) - self._weight(rotation)
        self.drift = float(np.linalg.norm(load[:3]))
        check_drift(self.drift, self.settings.drift_limit)
        return self.drift

    def _check_range(self, readings: Array) -> None:
        """Raise IsfError WRENCH_OUT_OF_RANGE for a saturated channel of ``readings`` (..., C)."""
        beyond = np.abs(readings) >= 0.99 * self.settings.range
        if beyond.any():
            channel = int(np.argmax(np.atleast_2d(beyond).any(axis=0))) + 1
            raise IsfError(
                ErrorCode.WRENCH_OUT_OF_RANGE,
                f"channel {channel} of the load cell is at the end of its range",
                advice="reduce the load, or use a cell with a larger range",
            )

    def _weight(self, rotation: Array | None) -> Array:
        """(3,) N or (6,) N and N m in axes of the cell, as the matrix has rows: tool and holder pull at it."""
        turn = self.settings.rotation if rotation is None else rotation
        force = np.asarray(turn.T @ (self.settings.mass * GRAVITY))
        return (
            force if len(self.settings.matrix) == 3 else np.concatenate([force, np.cross(self.settings.centre, force)])
        )


def check_steady(change: Array, drift_limit: float) -> None:
    """Raise IsfError NO_TARE when a force ``change`` (n, ...) N about its mean is not that of a free tool."""
    spread = float(np.abs(change).max())
    if spread > 0.5 * drift_limit + 5.0:
        raise IsfError(
            ErrorCode.NO_TARE, f"the force changes by {spread:.0f} N while it is tared", advice="move the tools clear"
        )
