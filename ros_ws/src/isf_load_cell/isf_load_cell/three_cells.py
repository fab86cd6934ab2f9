"""From raw readings of three tri-axial cells around a spindle to the wrench that force control uses.

The cells stand at 120 degrees between platform and spindle (Torrao 2013, 3.4.1). Nine channels tell three components:
any one may be lost, or (height up to 3.6 times the radius) those of any one cell; more, as long as the rest tells the
force. Readings that fit no force tell which channel is off as long as one is: two axial ones that are off alike throw
out the sound third. N, N m.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.spindle_cells import CHANNELS
from isf_core.types import Array
from isf_force_ctrl.laws.force_and_compliance import Fir, low_pass
from isf_force_ctrl.supervision.wrench_watch import check_drift

from isf_load_cell.cell_redundancy import CellRedundancy, Live, LoadsOf, Order, responses
from isf_load_cell.reading import GRAVITY, IN_LOCKSTEP, check_steady

RADIUS = 0.110
"""m, of the circle of cells (published)."""

SMOOTHING = 0.1
"""Share of a new reading in the smoothed ones by which channels are compared: noise does not show, a step at once."""

UNEXPLAINED = 3.0
"""Times the limit of the disagreement from which the force does not count any more, though no channel is found."""

SEARCH_GROWTH, SEARCH_AFTER = 1.1, 25
"""A search for the channel that found none is done again when the disagreement has grown so, or after that many
readings: it takes fifteen times as long as a reading."""

FROZEN_MOVE, FROZEN_STEPS, FROZEN_CONFIRM = 5.0, 3.0, 5
"""N, or steps of the converter (smallest change of readings at the tare), whichever is more, by which the load of a
channel that stands still must have moved by what the others read, for so many readings in a row, to call it frozen;
axial channels, which the others tell less exactly, by as much more."""


def readings_of(force: Array, height: float, radius: float = RADIUS) -> Array:
    """(3, 3) N, rows are cells: readings under ``force`` (3,) N (eq. 3.7, 3.8-3.10)."""
    return np.asarray((responses(height, radius) @ np.asarray(force, dtype=float)).reshape(3, 3))


@dataclass(frozen=True)
class ThreeCellSettings:
    """What is known of the three cells; rows of (3, 3) are cells, columns the channels x, y, axial.

    Attributes
    ----------
    gains : (3, 3) N per unit of the readings
    range : (3, 3) largest reading; beyond 99 % of it a channel counts as saturated
    height : m from the plane of the cells to the tip ; radius : m of their circle
    rotation : (3, 3) from axes of the platform to frame sheet
    names : of the nine channels, for people
    rate, cutoff, taps, mass, frozen_after, drift_limit : as in :class:`~isf_load_cell.reading.CellSettings`
    mass_height : m from the plane of the cells to the centre of what hangs below them
    inconsistency_limit : N by which the channels may disagree at rest ; inconsistency_ratio : and per N of force

    A channel that reads the same ``frozen_after`` times is frozen when its load has moved meanwhile; all of them are
    when they do so together.
    """

    gains: Array
    range: Array
    height: float
    rotation: Array
    names: tuple[str, ...] = CHANNELS
    rate: float = 500.0
    radius: float = RADIUS
    cutoff: float = 0.0
    taps: int | None = None
    mass: float = 0.0
    mass_height: float = 0.1
    frozen_after: int = 50
    drift_limit: float = 10.0
    inconsistency_limit: float = np.inf
    inconsistency_ratio: float = 0.01


@dataclass
class ThreeCellReading:
    """Three cells, reading by reading; a reading is (9,): x, y, axial of cell 1, then of cells 2 and 3."""

    settings: ThreeCellSettings
    lost: dict[int, IsfError] = field(init=False, default_factory=dict)
    """Channels (0 to 8) that take no part until the next tare, and why."""
    inconsistency: float = field(init=False, default=0.0)
    """N by which the channels disagree, smoothed."""
    drift: float = field(init=False, default=0.0)
    """N, unloaded force at the last call of :meth:`watch_drift`."""

    def __post_init__(self) -> None:
        s = self.settings
        coefficients = low_pass(s.cutoff, s.rate, s.taps) if s.cutoff > 0.0 else np.array([1.0])
        self._filters = [Fir(coefficients) for _ in range(3)]
        self._redundancy = CellRedundancy(s.height, s.radius)
        self._gains, self._range = s.gains.ravel(), 0.99 * s.range.ravel()
        self._per_weight = responses(s.mass_height, s.radius)
        self._zero, self._tared = np.zeros(9), False
        self._live: Live = (True,) * 9
        self._use = np.ones(9, dtype=bool)
        self._smooth = np.zeros(9)
        self._last, self._same = np.full(9, np.nan), np.zeros(9, dtype=int)
        self._then, self._moved = np.zeros((9, 9)), np.zeros(9, dtype=int)
        self._step = np.zeros(9)
        self._unexplained: IsfError | None = None
        self._told = False
        self._searched, self._since = 0.0, 0
        self._untold: list[IsfError] = []

    def tare(self, readings: Array, rotation: Array | None = None) -> None:
        """Zero from ``readings`` (n, 9) without contact; channels without signal take no part until the next tare.

        Raises IsfError WRENCH_NOT_FINITE, WRENCH_OUT_OF_RANGE (too many without), WRENCH_FROZEN (all stand still; one
        may, on a coarse converter), NO_TARE (the tool is being touched).
        """
        readings = np.asarray(readings, dtype=float)
        s, lost = self.settings, {}
        for k, column in enumerate(readings.T):
            if not np.isfinite(column).all():
                lost[k] = self._no_number(k)
            elif (np.abs(column) >= self._range[k]).any():
                lost[k] = self._saturated(k)
        live = tuple(k not in lost for k in range(9))
        self._check_known(live, lost)
        use, mean = np.array(live), readings.mean(axis=0)
        if len(readings) > s.frozen_after and (readings == readings[0])[:, use].all():
            raise _all_frozen(len(readings))
        check_steady((self._gains * (readings - mean))[:, use], s.drift_limit)
        self._zero = np.where(use, mean - self._weight(rotation) / self._gains, 0.0)
        self.lost, self._live, self._use, self._tared = lost, live, use, True
        self._untold = list(lost.values())
        self._smooth, self._same = np.where(use, mean, 0.0), np.zeros(9, dtype=int)
        self._then, self._moved = np.zeros((9, 9)), np.zeros(9, dtype=int)
        jumps = np.abs(np.diff(readings[:, use], axis=0)) / self._range[use]
        smallest = float(jumps[jumps > 0.0].min()) if jumps.any() else 0.0  # of any channel: they share a converter
        self._step = smallest * self._range * np.abs(self._gains)
        self._unexplained, self._told = None, False
        self._searched, self._since = 0.0, 0
        for fir in self._filters:
            fir.reset(0.0)

    def wrench(self, reading: Array, rotation: Array | None = None) -> Array:
        """(6,) N and N m on the tool in axes of frame sheet, filtered, torques zero, from ``reading`` (9,).

        ``rotation`` (3, 3) as in the settings, where it changes. Raises IsfError NO_TARE, and when the channels that
        are left do not tell the force, what happened last: WRENCH_NOT_FINITE, WRENCH_OUT_OF_RANGE, WRENCH_FROZEN or
        WRENCH_INCONSISTENT.
        """
        if not self._tared:
            raise IsfError(ErrorCode.NO_TARE, "the load cells were not tared", advice="tare them with the tools free")
        reading = np.asarray(reading, dtype=float)
        self._watch_each(reading)
        weight = self._weight(rotation)
        self._watch_frozen(reading, weight)
        self._watch_together(reading, weight)
        force = self._force(reading, weight)
        turn = self.settings.rotation if rotation is None else rotation
        found = [fir.step(float(value)) for fir, value in zip(self._filters, turn @ force, strict=True)]
        return np.array([*found, 0.0, 0.0, 0.0])

    def watch_drift(self, readings: Array, rotation: Array | None = None) -> float:
        """N, change of the unloaded force since the tare, from ``readings`` (n, 9) without contact.

        Raises IsfError NO_TARE when it is beyond the limit.
        """
        mean = np.asarray(readings, dtype=float).mean(axis=0)
        self.drift = float(np.linalg.norm(self._force(mean, self._weight(rotation))))
        check_drift(self.drift, self.settings.drift_limit)
        return self.drift

    def warning(self) -> IsfError | None:
        """Channels that are lost, though the rest tells the force, or a disagreement that no channel explains; None
        when all is well."""
        if not self.lost:
            return self._unexplained
        *_, last = self.lost.values()
        return IsfError(
            last.code,
            f"{'; '.join(reason.what for reason in self.lost.values())}; the force follows from the other channels",
            advice="repair, then tare",
        )

    def take_news(self) -> list[IsfError]:
        """Channels that were lost since the last call, and once after a tare a disagreement that none explains."""
        news, self._untold = self._untold, []
        return news

    def indispensable(self) -> tuple[str, ...]:
        """Names of the channels without which the others do not tell the force, by height and radius alone."""
        found = []
        for k, name in enumerate(self.settings.names):
            try:
                self._redundancy.force_matrix(tuple(j != k for j in range(9)))
            except IsfError:
                found.append(name)
        return tuple(found)

    # -- inside --------------------------------------------------------------------------------

    def _force(self, reading: Array, weight: Array) -> Array:
        """(3,) N in axes of the platform, without the weight (9,) N."""
        return np.asarray(self._redundancy.force_matrix(self._live) @ self._loads(reading, weight))

    def _loads(self, reading: Array, weight: Array) -> Array:
        """(9,) N in the channels without the ``weight`` (9,) N; 0 where they do not count."""
        return np.where(self._use, self._gains * (reading - self._zero) - weight, 0.0)

    def _loads_of(self, weight: Array) -> LoadsOf:
        """The smoothed readings in N, as if the cables stood in another order."""

        def loads(order: Order, with_zero: bool) -> Array:
            zero = self._zero[order] if with_zero else self._zero
            return np.where(self._use, self._gains * (self._smooth[order] - zero) - weight, 0.0)

        return loads

    def _watch_each(self, reading: Array) -> None:
        """Leave out channels that are no numbers or saturated; raise the last reason when that is too much."""
        with np.errstate(invalid="ignore"):
            sound = np.abs(reading) < self._range
        for k in np.flatnonzero(self._use & ~sound).tolist():
            self._lose(k, self._saturated(k) if np.isfinite(reading[k]) else self._no_number(k))

    def _watch_frozen(self, reading: Array, weight: Array) -> None:
        """Leave out channels that stand still while their load moves, by what the others read.

        Raises IsfError WRENCH_FROZEN when all stand still, and the last reason when too many are lost.
        """
        still = reading == self._last
        self._last = reading
        self._same = np.where(still, self._same + 1, 0)
        loads = self._loads(reading, weight)
        self._then[~still] = loads
        long = self._use & (self._same >= self.settings.frozen_after)
        if not long.any():
            self._moved[:] = 0
            return
        if long[self._use].all():
            raise _all_frozen(int(self._same[self._use].min()))
        move = self._load_moves(loads)
        self._moved = np.where(long & (move > 1.0), self._moved + 1, 0)
        while (late := self._use & (self._moved >= FROZEN_CONFIRM) & (move > 1.0)).any():
            k = int(np.argmax(np.where(late, move, 0.0)))
            self._lose(k, self._frozen(k, int(self._same[k])))
            move = self._load_moves(loads)  # what is frozen tells nothing of the next one

    def _load_moves(self, loads: Array) -> Array:
        """(9,) how far the load of each channel has moved by the others since it last read something else; 1: so far
        that it must have shown."""
        expected = self._redundancy.expected(self._live)
        least = np.maximum(FROZEN_MOVE, FROZEN_STEPS * self._step) * np.sqrt(1.0 + (expected**2).sum(axis=1))
        return np.asarray(np.abs((expected * (loads - self._then)).sum(axis=1)) / least)

    def _watch_together(self, reading: Array, weight: Array) -> None:
        """Leave out a channel with which the others disagree, and tell a disagreement that nothing explains.

        Raises IsfError WRENCH_INCONSISTENT when that is large.
        """
        s = self.settings
        self._smooth = np.where(self._use, self._smooth + SMOOTHING * (reading - self._smooth), 0.0)
        loads = self._loads(self._smooth, weight)
        self.inconsistency = self._redundancy.disagreement(loads, self._live)
        force = self._redundancy.force_matrix(self._live) @ loads  # as late as the disagreement
        limit = s.inconsistency_limit + s.inconsistency_ratio * float(np.linalg.norm(force))
        if self.inconsistency <= limit:
            self._unexplained = None
            self._searched, self._since = 0.0, 0
            return
        large = self.inconsistency > UNEXPLAINED * limit
        self._since += 1
        if not (large or self.inconsistency > SEARCH_GROWTH * self._searched or self._since >= SEARCH_AFTER):
            return
        self._searched, self._since = self.inconsistency, 0
        suspects, left = self._redundancy.suspects(loads, self._live)
        pair, left_by_pair = self._redundancy.exchanged(self._loads_of(weight), self._live)
        if pair and left_by_pair < 0.5 * left:
            suspects = pair
            what = f"the cables of load-cell channels {s.names[pair[0]]} and {s.names[pair[1]]} are exchanged"
        else:
            what = f"load-cell channel {' or '.join(s.names[k] for k in suspects)} disagrees with the others"
        if suspects:
            reason = IsfError(ErrorCode.WRENCH_INCONSISTENT, what)
            self._unexplained = None
            for k in suspects:
                self._lose(k, reason)
            return
        error = IsfError(
            ErrorCode.WRENCH_INCONSISTENT,
            f"the load-cell channels disagree by {self.inconsistency:.0f} N, and no single one explains it",
            advice="check gains, height, cables and inconsistency_limit",
        )
        if large:
            raise error
        self._unexplained = self._unexplained or error
        if not self._told:
            self._told = True
            self._untold.append(error)

    def _lose(self, channel: int, reason: IsfError) -> None:
        if reason not in self.lost.values():
            self._untold.append(reason)
        self.lost[channel] = reason
        self._searched = 0.0
        self._live = tuple(k not in self.lost for k in range(9))
        self._use = np.array(self._live)
        self._check_known(self._live, self.lost)

    def _check_known(self, live: Live, lost: dict[int, IsfError]) -> None:
        """Raise IsfError with the code of the last loss when the rest does not tell the force."""
        try:
            self._redundancy.force_matrix(live)
        except IsfError as error:
            *_, last = lost.values()
            reasons = "; ".join(dict.fromkeys(reason.what for reason in lost.values()))
            raise IsfError(last.code, f"{reasons}; {error.what}", advice="repair and tare") from error

    def _no_number(self, channel: int) -> IsfError:
        return IsfError(
            ErrorCode.WRENCH_NOT_FINITE, f"load-cell channel {self.settings.names[channel]} gives no reading"
        )

    def _saturated(self, channel: int) -> IsfError:
        what = f"load-cell channel {self.settings.names[channel]} is at the end of its range"
        return IsfError(ErrorCode.WRENCH_OUT_OF_RANGE, what)

    def _frozen(self, channel: int, times: int) -> IsfError:
        what = (
            f"load-cell channel {self.settings.names[channel]} has read the same {times} times under a load that moves"
        )
        return IsfError(ErrorCode.WRENCH_FROZEN, what)

    def _weight(self, rotation: Array | None) -> Array:
        """(9,) N by which the weight shows in each channel."""
        turn = self.settings.rotation if rotation is None else rotation
        return np.asarray(self._per_weight @ (turn.T @ (self.settings.mass * GRAVITY)))


def _all_frozen(times: int) -> IsfError:
    what = f"all load-cell channels have read the same {times} times: frozen signal"
    return IsfError(ErrorCode.WRENCH_FROZEN, what, advice=f"check the amplifier and its driver; {IN_LOCKSTEP}")
