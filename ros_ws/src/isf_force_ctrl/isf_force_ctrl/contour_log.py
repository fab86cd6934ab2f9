"""Tick-by-tick log of one contour and the result made from it."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from isf_core.contour import Contour, ContourResult
from numpy.typing import NDArray

from isf_force_ctrl.control_state import Flag, Mode

Array = NDArray[np.float64]

_FORCE_LOOP = int(Flag.SATURATED_ERROR | Flag.SATURATED_RATE | Flag.SATURATED_OFFSET)
_WIDTH = 21
"""Numbers per tick."""

_LOOP_MODES = (int(Mode.ENGAGE), int(Mode.CONTROL))


class ContourLog:
    """Ticks since a contour was started.

    A row belongs to the time of a wrench: the wrench, and the targets that were valid at that time.
    """

    def __init__(self, contour: Contour, forced: bool, backoffs: int = 0) -> None:
        self.contour = contour
        self._backoffs_before = backoffs
        self.forced = forced
        self.lost_messages = 0
        # Flat numbers, not tuples: making a table of ten thousand tuples would hold up a tick for 20 ms.
        self._numbers = array("d")
        self._measured: tuple[list[tuple[float, ...]], list[tuple[float, ...]]] = ([], [])

    def __len__(self) -> int:
        return len(self._numbers) // _WIDTH

    def add(
        self,
        state: tuple[float, int, int, float, float, float, float],
        compliance: tuple[float, float],
        forces: tuple[float, ...],
        tips: tuple[float, ...],
    ) -> None:
        """Keep one tick.

        ``state``: time, mode, flags, set-point, normal force, contour coordinate, force offset. ``forces`` and ``tips``
        are (6,): tool 1, then tool 2.
        """
        self._numbers.extend((*state, *compliance, *forces, *tips))

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """Keep a tip (3,) m reported by the machine."""
        self._measured[tool - 1].append((time, *tip))

    def result(self, completed: bool, code: int = 0, message: str = "", *, backoffs: int = 0) -> ContourResult:
        """Everything that happened; values at points that were not reached are NaN.

        ``backoffs``: oscillations found since arming.
        """
        table = self._table()
        time, mode, flags, set_point, normal_force = table[:, :5].T
        at_points = _point_times(table[:, 5], time, len(self.contour), completed=completed)
        values = _interpolated(at_points, time, table[:, 6:21])
        contour = self.contour
        forming, support = (slice(3, 6), slice(6, 9)) if contour.forming_tool == 1 else (slice(6, 9), slice(3, 6))
        forming_tip, support_tip = (slice(9, 12), slice(12, 15))
        if contour.forming_tool == 2:
            forming_tip, support_tip = support_tip, forming_tip
        engaged = mode == Mode.CONTROL
        contact = (flags.astype(int) & Flag.CONTACT_LOST) == 0
        looped = np.isin(mode, _LOOP_MODES)
        none3 = np.empty((0, 3))
        return ContourResult(
            plan_id=contour.plan_id,
            index=contour.index,
            start=float(time[0]) if len(time) else 0.0,
            end=float(time[-1]) if len(time) else 0.0,
            completed=completed,
            forming_force=values[:, forming],
            support_force=values[:, support] if contour.has_support else none3,
            forming_target=values[:, forming_tip],
            support_target=values[:, support_tip] if contour.has_support else none3,
            force_offset=values[:, 0] if self.forced else np.empty(0),
            compliance_offset=np.column_stack([values[:, 1:3], np.zeros(len(values))]),
            tick_time=time,
            tick_set_point=np.nan_to_num(set_point) if self.forced else np.empty(0),
            tick_normal_force=normal_force,
            tick_engaged=engaged,
            forming_measured=self._measured_at(contour.forming_tool - 1, at_points),
            support_measured=self._measured_at(2 - contour.forming_tool, at_points) if contour.has_support else none3,
            contact_fraction=float(contact[engaged].mean()) if engaged.any() else 0.0,
            saturations=int(np.count_nonzero(looped & ((flags.astype(int) & _FORCE_LOOP) != 0))),
            backoffs=backoffs - self._backoffs_before,
            lost_messages=self.lost_messages,
            code=code,
            message=message,
        )

    def profile(self) -> tuple[Array, Array]:
        """(K, 2) m of the forming tip in the plane and (K,) m offset of the force loop, along the contour."""
        table = self._table()
        table = table[table[:, 1] == Mode.CONTROL]
        if not len(table):
            return np.empty((0, 2)), np.empty(0)
        tip = 15 if self.contour.forming_tool == 1 else 18
        return table[:, tip : tip + 2] - table[:, 7:9], table[:, 6]

    def _table(self) -> Array:
        """(T, 21), one row per tick."""
        return np.array(self._numbers, dtype=float).reshape(-1, _WIDTH)

    def _measured_at(self, tool: int, at_points: Array) -> Array:
        if not self._measured[tool]:
            return np.empty((0, 3))
        rows = np.array(self._measured[tool])
        return _interpolated(at_points, rows[:, 0], rows[:, 1:])


def _point_times(coordinate: Array, time: Array, count: int, *, completed: bool) -> Array:
    """(N,) s, when each contour point was passed; NaN where it was not reached.

    A path that runs on is at its last point in the tick after the last one of the log.
    """
    on_path = np.isfinite(coordinate)
    if not on_path.any():
        return np.full(count, np.nan)
    passed = np.maximum.accumulate(coordinate[on_path])
    points = np.arange(count, dtype=float)
    times = np.interp(points, passed, time[on_path])
    return times if completed else np.where(points <= passed[-1] + 1e-6, times, np.nan)


def _interpolated(at: Array, time: Array, columns: Array) -> Array:
    """(N, C), columns interpolated at ``at``; NaN where ``at`` is NaN."""
    if not len(time):
        return np.full((len(at), columns.shape[1]), np.nan)
    known = np.isfinite(at)
    values = np.full((len(at), columns.shape[1]), np.nan)
    values[known] = np.column_stack([np.interp(at[known], time, c) for c in columns.T])
    return values
