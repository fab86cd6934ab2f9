"""Readings of a load cell in, wrenches out: when a wrench may be published, and what is told otherwise.

A fault of the cell (not a number, saturated, frozen, channels that contradict each other) ends the stream until the
next tare: force control holds on a stream that stops, and a cell that was overloaded may have shifted, so it must not
come back by itself.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Protocol

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

from isf_load_cell.reading import IN_LOCKSTEP


class Reading(Protocol):
    """One cell or an arrangement of cells: load_cell_reading.CellReading, three_cell_reading.ThreeCellReading."""

    def tare(self, readings: Array, rotation: Array | None = None) -> None:
        """Zero from readings (n, C) without contact."""

    def wrench(self, reading: Array, rotation: Array | None = None) -> Array:
        """(6,) N and N m in axes of frame sheet from a reading (C,)."""
        ...

    def watch_drift(self, readings: Array, rotation: Array | None = None) -> float:
        """N, change of the unloaded force since the tare."""
        ...

    def warning(self) -> IsfError | None:
        """What a person should look at though the wrench is right."""

    def take_news(self) -> list[IsfError]:
        """What was lost since the last call, though the wrench is right."""
        ...


class CellStream:
    """``reading`` turns readings into wrenches; zero and drift come from the last ``tare_readings`` of them.

    Those from before a silence of more than ``longest_gap`` s, by the stamps, do not count: the driver may have been
    started anew, with another zero.
    """

    def __init__(self, reading: Reading, tare_readings: int, longest_gap: float = math.inf) -> None:
        self._reading, self._needed, self._gap = reading, tare_readings, 1e9 * longest_gap
        self._recent: deque[Array] = deque(maxlen=tare_readings)
        self._rotation: Array | None = None
        self._stamp = 0
        self._wrench: Array | None = None
        self._drift: IsfError | None = None
        self.fault: IsfError | None = IsfError(
            ErrorCode.NO_TARE, "the load cell was not tared", advice="tare it with the tools free"
        )
        """Why no wrenches are given out; None when they are."""
        self.faults = 0
        """Faults since the start."""

    def add(self, stamp: int, reading: Array, rotation: Array | None = None) -> Array | None:
        """(6,) wrench of ``reading`` (C,) with ``stamp`` ns, None when none is to be published; sets :attr:`fault`.

        ``rotation`` (3, 3) from axes of the cell to frame sheet, where it changes. A stamp that repeats is a sign of
        life of a machine that waits (docs/reference/architecture.md, lockstep): no new reading, the same wrench again.
        """
        again = bool(stamp) and stamp == self._stamp
        if stamp and self._stamp and abs(stamp - self._stamp) > self._gap:
            self._recent.clear()
        if again and self._wrench is not None:
            return self._wrench
        self._stamp, self._rotation, self._wrench = stamp, rotation, None
        if not again:
            self._recent.append(reading)
        if self.fault is None:
            try:
                self._wrench = self._reading.wrench(reading, rotation)
            except IsfError as error:
                self.fault = error
                self.faults += 1
        return self._wrench

    def tare(self) -> int:
        """Zero from the last readings, and an end of every fault; returns how many. Raises IsfError as the cell."""
        readings = self._last_readings()
        self._reading.tare(readings, self._rotation)
        self.fault = self._drift = self._wrench = None
        return len(readings)

    def check_drift(self) -> float:
        """N, change of the unloaded force since the tare; beyond the limit it stays a warning until the next tare.

        Raises IsfError NO_TARE (beyond the limit, too few readings), or the present fault.
        """
        if self.fault is not None:
            raise self.fault
        readings = self._last_readings()
        try:
            drift = self._reading.watch_drift(readings, self._rotation)
        except IsfError as error:
            self._drift = error
            raise
        self._drift = None
        return drift

    def warning(self) -> IsfError | None:
        """What a person should look at though wrenches are given out."""
        return self._reading.warning() or self._drift

    def take_news(self) -> list[IsfError]:
        """What was lost since the last call; the fault that ends the stream is not among it."""
        return self._reading.take_news()

    def _last_readings(self) -> Array:
        if len(self._recent) < self._needed:
            raise IsfError(
                ErrorCode.NO_TARE,
                f"{len(self._recent)} readings so far, {self._needed} are needed",
                advice=f"ask again, or lower tare_readings; {IN_LOCKSTEP}",
            )
        return np.array(self._recent)
