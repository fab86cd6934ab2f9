"""From raw readings of three tri-axial cells around a spindle to the wrench that force control uses.

The arrangement and its fall-back are those of :mod:`isf_force_ctrl.three_cells` (Torrao 2013, 3.4.1). A cell that gives
no number, is at the end of its range or is frozen counts as lost until the next tare, and its force follows from the
other two; two lost cells are a fault. SI units; forces as the sheet does to the tool.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

from isf_force_ctrl.drift_watch import check_drift
from isf_force_ctrl.load_cell_filter import Fir, low_pass
from isf_force_ctrl.load_cell_reading import GRAVITY, check_steady
from isf_force_ctrl.three_cells import RADIUS, force_of, readings_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ThreeCellSettings:
    """What is known of the three cells; rows of (3, 3) are cells, columns the channels x, y, axial.

    Attributes
    ----------
    gains : (3, 3) N per unit of the readings
    range : (3, 3) largest reading; beyond 99 % of it a channel counts as saturated
    height : m from the plane of the cells to the tip ; radius : m of their circle
    rotation : (3, 3) from axes of the platform to frame sheet
    rate, cutoff, taps, mass, frozen_after, drift_limit : as in :class:`~isf_force_ctrl.load_cell_reading.CellSettings`
    mass_height : m from the plane of the cells to the centre of what hangs below them
    inconsistency_limit : N, difference of the horizontal force by axial and by shear channels that is told
    """

    gains: Array
    range: Array
    height: float
    rotation: Array
    rate: float = 500.0
    radius: float = RADIUS
    cutoff: float = 0.0
    taps: int | None = None
    mass: float = 0.0
    mass_height: float = 0.1
    frozen_after: int = 50
    drift_limit: float = 10.0
    inconsistency_limit: float = np.inf


@dataclass
class ThreeCellReading:
    """Three cells, reading by reading; a reading is (9,): x, y, axial of cell 1, then of cells 2 and 3."""

    settings: ThreeCellSettings
    lost: dict[int, IsfError] = field(init=False, default_factory=dict)
    """Cells (1, 2, 3) that take no part until the next tare, and why."""
    inconsistency: float = field(init=False, default=float("nan"))
    """N, of the last reading; NaN when a cell is lost."""
    drift: float = field(init=False, default=0.0)
    """N, unloaded force at the last call of :meth:`watch_drift`."""

    def __post_init__(self) -> None:
        s = self.settings
        coefficients = low_pass(s.cutoff, s.rate, s.taps) if s.cutoff > 0.0 else np.array([1.0])
        self._filters = [Fir(coefficients) for _ in range(3)]
        self._zero, self._tared = np.zeros((3, 3)), False
        self._last, self._same = np.full((3, 3), np.nan), np.zeros(3, dtype=int)

    def tare(self, readings: Array, rotation: Array | None = None) -> None:
        """Zero from ``readings`` (n, 9) without contact; one cell may be without signal.

        Raises IsfError WRENCH_NOT_FINITE (two cells without), NO_TARE (the tool is being touched).
        """
        cells = np.asarray(readings, dtype=float).reshape(-1, 3, 3)
        s, dead = self.settings, ~np.isfinite(cells).all(axis=(0, 2))
        lost = {int(k) + 1: _no_number(int(k) + 1) for k in np.flatnonzero(dead)}
        _check_lost(lost)
        mean = cells.mean(axis=0)
        check_steady(s.gains[~dead] * (cells - mean)[:, ~dead], s.drift_limit)
        self._zero = np.where(dead[:, None], np.nan, mean - self._weight(rotation) / s.gains)
        self.lost, self._tared = lost, True
        for fir in self._filters:
            fir.reset(0.0)

    def wrench(self, reading: Array, rotation: Array | None = None) -> Array:
        """(6,) N and N m on the tool in axes of frame sheet, filtered, torques zero, from ``reading`` (9,).

        ``rotation`` (3, 3) as in the settings, where it changes. Raises IsfError NO_TARE, and when two cells are lost
        WRENCH_NOT_FINITE, WRENCH_OUT_OF_RANGE or WRENCH_FROZEN, what happened last.
        """
        if not self._tared:
            raise IsfError(ErrorCode.NO_TARE, "the load cells were not tared", advice="tare them with the tools free")
        cells = np.asarray(reading, dtype=float).reshape(3, 3)
        self._watch(cells)
        found = force_of(self._forces(cells, rotation), self.settings.height, self.settings.radius)
        self.inconsistency = found.inconsistency
        turn = self.settings.rotation if rotation is None else rotation
        force = [fir.step(float(value)) for fir, value in zip(self._filters, turn @ found.force, strict=True)]
        return np.array([*force, 0.0, 0.0, 0.0])

    def watch_drift(self, readings: Array, rotation: Array | None = None) -> float:
        """N, change of the unloaded force since the tare, from ``readings`` (n, 9) without contact.

        Raises IsfError NO_TARE when it is beyond the limit, WRENCH_NOT_FINITE when two cells are lost.
        """
        s = self.settings
        mean = np.asarray(readings, dtype=float).reshape(-1, 3, 3).mean(axis=0)
        self.drift = float(np.linalg.norm(force_of(self._forces(mean, rotation), s.height, s.radius).force))
        check_drift(self.drift, s.drift_limit)
        return self.drift

    def warning(self) -> IsfError | None:
        """A lost cell, or axial and shear channels that disagree by more than the limit; None when all is well."""
        for cell, reason in self.lost.items():
            return IsfError(
                reason.code,
                f"{reason.what}; forces follow from the other two cells",
                advice=f"repair cell {cell}, tare",
            )
        if self.inconsistency > self.settings.inconsistency_limit:
            return IsfError(
                ErrorCode.WRENCH_OUT_OF_RANGE,
                "axial and shear channels of the load cells disagree on the horizontal force by more than "
                f"{self.settings.inconsistency_limit:.0f} N",
                advice="check gains, height and cables",
            )
        return None

    def _watch(self, cells: Array) -> None:
        """Note cells that are lost from now on; raise the last reason when that leaves fewer than two."""
        s = self.settings
        self._same = np.where((cells == self._last).all(axis=1), self._same + 1, 0)
        self._last = cells
        finite = np.asarray(np.isfinite(cells).all(axis=1))
        saturated = np.asarray((np.abs(cells) >= 0.99 * s.range).any(axis=1))
        for k in range(3):
            if not finite[k]:
                self.lost.setdefault(k + 1, _no_number(k + 1))
            elif saturated[k]:
                what = f"load cell {k + 1} is at the end of its range"
                self.lost.setdefault(k + 1, IsfError(ErrorCode.WRENCH_OUT_OF_RANGE, what))
            elif self._same[k] >= s.frozen_after:
                what = f"load cell {k + 1} has read the same {self._same[k]} times: frozen signal"
                self.lost.setdefault(k + 1, IsfError(ErrorCode.WRENCH_FROZEN, what))
        _check_lost(self.lost)

    def _forces(self, cells: Array, rotation: Array | None) -> Array:
        """(3, 3) N of each cell, without the weight; rows of lost cells are NaN."""
        forces = self.settings.gains * (cells - self._zero) - self._weight(rotation)
        forces[[cell - 1 for cell in self.lost]] = np.nan
        return np.asarray(forces)

    def _weight(self, rotation: Array | None) -> Array:
        """(3, 3) N by which the weight shows in each channel."""
        s = self.settings
        turn = s.rotation if rotation is None else rotation
        return readings_of(turn.T @ (s.mass * GRAVITY), s.mass_height, s.radius)


def _no_number(cell: int) -> IsfError:
    return IsfError(ErrorCode.WRENCH_NOT_FINITE, f"load cell {cell} gives no reading")


def _check_lost(lost: dict[int, IsfError]) -> None:
    """Raise IsfError when two or three cells are ``lost``."""
    if len(lost) > 1:
        *_, last = lost.values()
        raise IsfError(
            last.code,
            "; ".join(reason.what for reason in lost.values()),
            advice="one of the three cells may fail, not two; repair and tare",
        )
