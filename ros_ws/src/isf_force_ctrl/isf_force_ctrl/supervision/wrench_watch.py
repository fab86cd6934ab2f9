"""Are the wrenches believable: finite, within the rig's force limits, alive, of the right sign and without drift?

Drift of a load cell since its tare is the force left when the tool is known to be off the sheet. N, s, frame ``sheet``.
Node ``load_cell`` judges drift on request, from raw readings (:func:`check_drift`); the force controller watches it by
itself (:class:`DriftWatch`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from isf_core.errors import ErrorCode, IsfError

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.motion.segments import Row
from isf_force_ctrl.motion.tool_moves import Tools

Vector = tuple[float, float, float]


_PRESSING = (Mode.ENGAGE, Mode.CONTROL, Mode.POSITION)
"""Modes in which the forming tool is on the sheet."""

_FORMING = (Mode.APPROACH, *_PRESSING)
"""Modes in which tools move into the sheet or along it, so that they had better stand where no force is known."""

_SQUEEZING = (Mode.ENGAGE, Mode.CONTROL)
"""Modes in which the support tool is held in contact."""

_NOTHING = (0.0, 0.0, 0.0)

MOVES = 1e-3
"""m/s, above which a tool counts as moving: what presses on it changes then, so even a cell without any noise reads
something new."""

REPEATING = 0.03
"""s after which readings that repeat exactly are doubted: tools shall stand 0.05 s after a signal has frozen."""

FORGETTING = 0.999
"""By which the usual number of repetitions shrinks with every reading that is a new one: it takes 1,000 of them."""


class WrenchWatch:
    """Watches the wrenches of both tools tick by tick.

    A load cell that works is never still: its noise alone changes a loaded reading from tick to tick, so readings that
    repeat exactly for ``frozen_time`` come from a signal that has frozen; the same reading used again, because no new
    one has come (by the clock), is none. Until that is certain, readings that repeat while their tool moves, for longer
    than those of this cell usually do, are told as :attr:`repeating`. Contacts only push: a forming tool on the sheet
    reads an axial force away from the sheet, and a squeezed support tool a positive normal force. The opposite, by more
    than ``sign_force`` for ``sign_time``, is a cell with a wrong sign; a force loop would push ever harder.
    """

    def __init__(self, config: ControlConfig) -> None:
        self._limit, self._loaded = config.force_limit, config.contact_threshold
        self._frozen_after = config.frozen_time * config.rate
        self._sign_force, self._sign_after = config.sign_force, config.sign_time * config.rate
        self._last: list[Vector] = [_NOTHING, _NOTHING]
        self._used: list[Sequence[float]] = [_NOTHING, _NOTHING]
        self._same, self._against = [0, 0], [0, 0]
        self._moving_same = [0, 0]
        """Repetitions in a row in which the tool moved."""
        self._row: Row | None = None
        self._least_way = MOVES / config.rate
        self._usual = [0.0, 0.0]
        """Repetitions in a row that a cell of coarse steps, or one slower than its driver, shows lately."""
        self._doubtful = max(3.0, REPEATING * config.rate) if math.isfinite(config.frozen_time) else math.inf
        self.repeating = 0
        """Tool of whose force nothing new is told, most likely; 0: none."""

    def retune(self, config: ControlConfig) -> None:
        """Another threshold of what counts as loaded."""
        self._loaded = config.contact_threshold

    def check(
        self,
        wrench_1: Sequence[float],
        wrench_2: Sequence[float],
        forming: int,
        mode: Mode,
        normal_force: float,
        row: Row,
    ) -> tuple[ErrorCode, str] | None:
        """Code and text of what is wrong with the wrenches (6,) of this tick, None when nothing is.

        ``forming`` is the forming tool (1, 2), ``normal_force`` N that of the support tool, ``row`` holds the tips of
        the path at this tick.
        """
        before, self._row = self._row, row
        if not plausible(wrench_1, wrench_2, self._limit):
            return fault_of(wrench_1, wrench_2, self._limit)
        for index, wrench in ((0, wrench_1), (1, wrench_2)):
            if wrench is self._used[index]:
                continue
            self._used[index] = wrench
            force = (wrench[0], wrench[1], wrench[2])
            if force != self._last[index] or max(map(abs, force)) < self._loaded:
                self._usual[index] = max(float(self._moving_same[index]), FORGETTING * self._usual[index])
                self._last[index], self._same[index], self._moving_same[index] = force, 0, 0
                if self.repeating == index + 1:
                    self.repeating = 0
                continue
            self._same[index] += 1
            if mode in _FORMING and before is not None and self._moved(before, row, index):
                self._moving_same[index] += 1
                if self._moving_same[index] >= max(self._doubtful, 3.0 * self._usual[index]):
                    self.repeating = index + 1
            if self._same[index] >= self._frozen_after:
                return ErrorCode.WRENCH_FROZEN, (
                    f"tool_{index + 1}/wrench has been the same {self._same[index]} times under load: frozen signal "
                    "(check the load cell's driver)"
                )
        pressing = mode in _PRESSING
        axial = wrench_1[2] if forming == 1 else -wrench_2[2]
        for index, force_of, text in (
            (0, axial if pressing else 0.0, f"the forming tool_{forming} presses on the sheet, but its Fz"),
            (
                1,
                normal_force if mode in _SQUEEZING else 0.0,
                f"the support tool_{3 - forming} is squeezed, but its normal force",
            ),
        ):
            self._against[index] = self._against[index] + 1 if force_of < -self._sign_force else 0
            if self._against[index] > self._sign_after:
                return ErrorCode.LOAD_CELL_SIGN, (
                    f"{text} has the wrong sign ({force_of:.0f} N; a wrench is what the sheet does to the tool, in "
                    "axes of frame sheet)"
                )
        return None

    def _moved(self, before: Row, row: Row, index: int) -> bool:
        tip = slice(3 * index, 3 * index + 3)
        return math.dist(before[tip], row[tip]) > self._least_way


def plausible(wrench_1: Sequence[float], wrench_2: Sequence[float], limit: Vector) -> bool:
    """True when both wrenches (6,) are finite and their forces within ``limit`` (3,) N."""
    x, y, z = limit
    total = float(sum(wrench_1) + sum(wrench_2))
    return bool(
        math.isfinite(total)
        and -x <= wrench_1[0] <= x
        and -y <= wrench_1[1] <= y
        and -z <= wrench_1[2] <= z
        and -x <= wrench_2[0] <= x
        and -y <= wrench_2[1] <= y
        and -z <= wrench_2[2] <= z
    )


def fault_of(wrench_1: Sequence[float], wrench_2: Sequence[float], limit: Vector) -> tuple[ErrorCode, str]:
    """Code and text for wrenches that are not :func:`plausible`."""
    for tool, wrench in ((1, wrench_1), (2, wrench_2)):
        values = np.asarray(wrench, dtype=float)
        if not np.isfinite(values).all():
            return ErrorCode.WRENCH_NOT_FINITE, f"tool_{tool}/wrench is not finite (check the load cell and its cable)"
        beyond = np.abs(values[:3]) > limit
        if beyond.any():
            axis = int(np.argmax(beyond))
            return (
                ErrorCode.WRENCH_OUT_OF_RANGE,
                f"tool_{tool} reads {values[axis]:.0f} N in {'xyz'[axis]}, the rig allows {limit[axis]:.0f} N "
                "(smaller steps, path.incremental_depth, or less support force; limits.force if the rig bears more)",
            )
    return ErrorCode.WRENCH_NOT_FINITE, "the sum of the wrenches is not finite"


WINDOW = 0.1
"""s of free tool that make one mean: the low-pass of the watch (assumed). The move from park to the first contour at
60 mm/s takes longer than that from 2 mm on; noise of 1 N per reading is 0.15 N in it."""

_NAN = float("nan")
_ENGAGING = (Mode.ARMED, Mode.APPROACH)
"""Modes after which the tools come into contact."""


def drift_error(drift: float, cell: str = "the load cell") -> IsfError:
    """What is told of a ``cell`` that reads ``drift`` N with its tool free."""
    return IsfError(
        ErrorCode.NO_TARE, f"{cell} has drifted by {drift:.1f} N since its tare", advice="tare it again, tools free"
    )


def check_drift(drift: float, limit: float) -> None:
    """Raise IsfError NO_TARE when the unloaded force has changed by more than ``limit`` N since the tare."""
    if not drift <= limit:
        raise drift_error(drift)


class DriftWatch:
    """Compares the mean force on each tool with zero, over every :data:`WINDOW` in which the tool is off the sheet.

    A tool counts as off the sheet where its commanded tip is at park height, or nearer to it than ``clearance``: there
    no sheet, die or holder reaches, however far the sheet springs back. It may move meanwhile: 2 kg at 0.5 m/s^2 are
    1 N. A tool that takes no part in the contour is not watched.
    """

    def __init__(self, config: ControlConfig) -> None:
        self._height = config.park_height - config.clearance
        self._limit, self._stop = config.drift_limit, config.drift_stop
        self._window = max(1, round(WINDOW * config.rate))
        self._counts = [0, 0]
        self._sums = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
        self._news: IsfError | None = None
        self._untold = True
        self.drift = [_NAN, _NAN]
        """N, of tool 1 and of tool 2 when they were off the sheet last; NaN: not known yet."""
        self.warning: IsfError | None = None
        """Of the last look at each tool, the larger drift that is beyond the limit; None when none is."""

    def retune(self, config: ControlConfig) -> None:
        """Other limits, from the next look on."""
        self._limit, self._stop = config.drift_limit, config.drift_stop

    def restart(self) -> None:
        """The tools may not have followed: begin the looks anew."""
        self._counts = [0, 0]

    def check(
        self, row: Row, tools: Tools, mode: Mode, forces: Sequence[float], fresh: tuple[bool, bool] = (True, True)
    ) -> tuple[ErrorCode, str] | None:
        """Take in the ``forces`` (6,) N on tool 1 and tool 2 of one tick, with the tips of ``row``.

        A tool whose forces are not ``fresh`` but those of the tick before is not looked at: they are of another place.
        Returns code and text when the drift is too large to go on to the sheet, None otherwise.
        """
        if row[2] < self._height and -row[5] < self._height:
            self._counts = [0, 0]
            return None
        found = None
        for index, height in ((0, row[2]), (1, -row[5])):
            if height < self._height or not tools.moves(index + 1):
                self._counts[index] = 0
                continue
            if not fresh[index]:
                continue
            count, sums = self._counts[index], self._sums[index]
            for axis in range(3):
                force = forces[3 * index + axis]
                sums[axis] = force if count == 0 else sums[axis] + force
            self._counts[index] = count + 1
            if count + 1 == self._window:
                self._counts[index] = 0
                self.drift[index] = math.hypot(*sums) / self._window
                found = self._judge(index, mode) or found
        return found

    def news(self) -> tuple[int, str]:
        """Code and text of a drift found since the last call, for the result of a contour; 0 and "" without one."""
        error, self._news = self._news, None
        return (0, "") if error is None else (int(error.code), error.message)

    def values(self) -> dict[str, object]:
        """Numbers for ``/diagnostics``: N, of the tools that were off the sheet."""
        return {f"drift_{k}": f"{drift:.1f}" for k, drift in enumerate(self.drift, 1) if math.isfinite(drift)}

    def untold(self) -> IsfError | None:
        """The present warning, once; again only after the drift was below the limit."""
        error, untold = self.warning, self._untold
        self._untold = error is None
        return error if untold else None

    def _judge(self, index: int, mode: Mode) -> tuple[ErrorCode, str] | None:
        """After a new mean of tool ``index`` + 1: warn, and say whether the tools must not go on."""
        known = [(drift, k) for k, drift in enumerate(self.drift) if drift > self._limit]
        self.warning = self._error(*max(known)) if known else None
        drift = self.drift[index]
        if drift > self._limit:
            self._news = self._error(drift, index)
        if drift > self._stop and mode in _ENGAGING:
            return ErrorCode.NO_TARE, self._error(drift, index).message
        return None

    def _error(self, drift: float, index: int) -> IsfError:
        return drift_error(drift, f"the load cell of tool_{index + 1}")
