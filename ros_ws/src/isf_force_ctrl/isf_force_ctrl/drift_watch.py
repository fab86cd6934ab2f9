"""Drift of a load cell since its tare: the force that is left when the tool is known to be off the sheet.

Node ``load_cell`` judges it on request, from raw readings (:func:`check_drift`). The force controller watches it by
itself (:class:`DriftWatch`), from the wrenches it is given, whoever made them. N, axes of frame ``sheet``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from isf_core.errors import ErrorCode, IsfError

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.segments import Row
from isf_force_ctrl.tool_moves import Tools

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

    def look(self, row: Row, tools: Tools, mode: Mode, forces: Sequence[float]) -> tuple[ErrorCode, str] | None:
        """Take in the ``forces`` (6,) N on tool 1 and tool 2 of one tick, with the tips of ``row``.

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
