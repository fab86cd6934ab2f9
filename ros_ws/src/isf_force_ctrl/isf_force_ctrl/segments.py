"""The queue of segments one contour is made of: approach or link, engage, contour, lift, park.

A segment holds one row of plain floats per control tick, ready for the controller's per-tick scalar arithmetic.
Consecutive segments meet at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from isf_force_ctrl import tool_moves
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Mode
from isf_force_ctrl.tool_moves import Posture
from isf_force_ctrl.trajectory import Motion, ToolPath, sample

Array = NDArray[np.float64]
Row = list[float]


class Column(IntEnum):
    """Where a quantity is in a row; tips take three columns each."""

    TIP_1 = 0
    TIP_2 = 3
    NORMAL_X = 6
    NORMAL_Y = 7
    SET_POINT = 8
    COORDINATE = 9
    SPEED = 10
    LEARNED = 11


@dataclass(frozen=True)
class Segment:
    """Rows of one mode; ``waits``: stay at the only row until the force has settled."""

    mode: Mode
    rows: list[Row]
    waits: bool = False


def contour_segments(
    config: ControlConfig, path: ToolPath, feed: float, here: Posture, *, engaged: bool, clear: bool, normal: Array
) -> list[Segment]:
    """Segments from ``here`` along ``path``.

    Parameters
    ----------
    engaged : the support tool is in contact under force control now
    clear : the tools are clear of the sheet, so that a long way needs no lift
    normal : (3,) of the sheet where the tools are, for lifting
    """
    start = Posture(path.tip_1[0], path.tip_2[0], float(path.direction[0]))
    forced = bool(np.isfinite(path.set_point[0]))
    with_support = bool(np.abs(path.tip_2 - here.tip_2).max() > 1e-9)
    segments: list[Segment] = []
    short = None if clear else tool_moves.link(config, here, start, feed)
    if short is not None:
        keep = forced and engaged
        set_point = float(path.set_point[0]) if keep else float("nan")
        segments.append(Segment(Mode.ENGAGE if keep else Mode.APPROACH, rows_of(short, set_point)))
    else:
        if not clear:
            segments += _segments(Mode.LIFT, tool_moves.lift(config, here, normal, with_support=with_support))
            if segments:
                here = posture_of(segments[-1].rows[-1])
        moves = tool_moves.approach(config, here, start, feed, with_support=with_support)
        segments += _segments(Mode.APPROACH, moves)
    motion = sample(path, feed, tool_moves.limits_of(config))
    rows = rows_of(motion)
    if forced:
        wait = list(rows[0])
        wait[Column.COORDINATE] = float("nan")
        segments.append(Segment(Mode.ENGAGE, [wait], waits=True))
    segments.append(Segment(Mode.CONTROL if forced else Mode.POSITION, rows))
    return segments


def lift_segments(config: ControlConfig, here: Posture, normal: Array, *, with_support: bool) -> list[Segment]:
    """Lift both tools clear and park them."""
    moves = tool_moves.lift(config, here, normal, with_support=with_support)
    segments = _segments(Mode.LIFT, moves)
    if segments:
        here = posture_of(segments[-1].rows[-1])
    return segments + _segments(Mode.LIFT, tool_moves.park(config, here, with_support=with_support))


def rows_of(motion: Motion, set_point: float | None = None) -> list[Row]:
    """One row per tick; ``set_point`` N replaces the motion's own."""
    wanted = motion.set_point if set_point is None else np.full(len(motion), set_point)
    table = np.column_stack(
        [
            motion.tip_1,
            motion.tip_2,
            motion.normal,
            wanted,
            motion.coordinate,
            motion.speed,
            np.zeros(len(motion)),
        ]
    )
    rows: list[Row] = table.tolist()
    return rows


def posture_of(row: Row) -> Posture:
    """Tips and direction of d_n of a row."""
    return Posture(
        np.array(row[Column.TIP_1 : Column.TIP_1 + 3]),
        np.array(row[Column.TIP_2 : Column.TIP_2 + 3]),
        float(np.arctan2(row[Column.NORMAL_Y], row[Column.NORMAL_X])),
    )


def _segments(mode: Mode, moves: list[Motion]) -> list[Segment]:
    return [Segment(mode, rows_of(motion)) for motion in moves]
