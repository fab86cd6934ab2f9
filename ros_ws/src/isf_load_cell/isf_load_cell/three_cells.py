"""From raw readings of three tri-axial cells around a spindle to the wrench that force control uses.

The cells stand at 120 degrees between platform and spindle; any one may fail (Torrao 2013, 3.4.1). N, N m.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_force_ctrl.laws.force_and_compliance import Fir, low_pass
from isf_force_ctrl.supervision.wrench_watch import check_drift

from isf_load_cell.reading import GRAVITY, check_steady

RADIUS = 0.110
"""m, of the circle of cells (published)."""


@dataclass(frozen=True)
class ThreeCellForce:
    """``force`` (3,) N: horizontal x, y and vertical; ``shear`` (2,) N: horizontal by the shear channels;
    ``inconsistency`` N: how far the two disagree, NaN when a cell is missing; ``missing``: cell without signal or 0."""

    force: Array
    shear: Array
    inconsistency: float
    missing: int


def decomposition(height: float, radius: float = RADIUS) -> Array:
    """(3, 3), horizontal x, y and vertical force from the three axial readings (eq. 3.3-3.6); lengths in m."""
    lever, root = radius / height, np.cos(np.radians(30.0))
    return np.array([[lever, -lever / 2, -lever / 2], [0.0, lever * root, -lever * root], [1.0, 1.0, 1.0]])


def force_of(readings: Array, height: float, radius: float = RADIUS) -> ThreeCellForce:
    """Force on the tool from ``readings`` (3, 3) N: rows are cells, columns x, y, axial; one row may be NaN.

    Raises IsfError WRENCH_NOT_FINITE when more than one cell is missing.
    """
    readings = np.asarray(readings, dtype=float)
    dead = ~np.isfinite(readings).all(axis=1)
    if dead.sum() > 1:
        raise IsfError(
            ErrorCode.WRENCH_NOT_FINITE,
            f"load cells {', '.join(str(k + 1) for k in np.flatnonzero(dead))} give no reading",
            advice="one of the three cells may fail, not two",
        )
    if not dead.any():
        force = decomposition(height, radius) @ readings[:, 2]
        shear = readings[:, :2].sum(axis=0)
        return ThreeCellForce(force, shear, float(np.linalg.norm(force[:2] - shear)), 0)
    lost = int(np.argmax(dead))
    shear = 1.5 * readings[~dead, :2].sum(axis=0)
    axial = readings[:, 2].copy()
    lever, root = radius / height, np.cos(np.radians(30.0))
    if lost == 0:
        axial[0] = (shear[0] + 0.5 * lever * (axial[1] + axial[2])) / lever
    elif lost == 1:
        axial[1] = axial[2] + shear[1] / (lever * root)
    else:
        axial[2] = axial[1] - shear[1] / (lever * root)
    return ThreeCellForce(np.array([*shear, axial.sum()]), shear, float("nan"), lost + 1)


def readings_of(force: Array, height: float, radius: float = RADIUS) -> Array:
    """(3, 3) N, readings under ``force`` (3,) N (eq. 3.7, 3.8-3.10): the shear is shared equally."""
    axial = np.linalg.solve(decomposition(height, radius), np.asarray(force, dtype=float))
    return np.column_stack([np.full(3, force[0] / 3), np.full(3, force[1] / 3), axial])


@dataclass(frozen=True)
class ThreeCellSettings:
    """What is known of the three cells; rows of (3, 3) are cells, columns the channels x, y, axial.

    Attributes
    ----------
    gains : (3, 3) N per unit of the readings
    range : (3, 3) largest reading; beyond 99 % of it a channel counts as saturated
    height : m from the plane of the cells to the tip ; radius : m of their circle
    rotation : (3, 3) from axes of the platform to frame sheet
    rate, cutoff, taps, mass, frozen_after, drift_limit : as in :class:`~isf_load_cell.reading.CellSettings`
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
