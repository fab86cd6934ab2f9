"""The axes of the machine: position loop, and the errors between what the encoders read and the true tips.

Position loop: third order, exact zero-order hold at the servo rate. Errors: backlash, 1-D error tables, volumetric
error map. m, s.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import LARGEST_TABLE, read_lines
from isf_core.files.rig import Rig, ToolAxis
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import brentq

from isf_sim.jit import kernel


class ServoConstants(NamedTuple):
    """Substeps per control tick; transition (3, 3) and input (3,) of one substep for (x, v, a) of the closed loop;
    lead s: feedforward times the loop's lag; limit m: of the following error (infinite: none), and with it the
    transition and input of the open loop that the limited error drives; period s of a substep."""

    substeps: int
    transition: Array
    input: Array
    lead: float
    limit: float
    open_transition: Array
    open_input: Array
    period: float


def natural_frequency(bandwidth: float, damping: float, pole_ratio: float) -> float:
    """rad/s, wn for which |G| = -3 dB at ``bandwidth`` Hz, with p = pole_ratio wn."""

    def excess(ratio: float) -> float:
        s = 1j * ratio
        return float(abs(pole_ratio / ((s + pole_ratio) * (s * s + 2.0 * damping * s + 1.0))) - np.sqrt(0.5))

    return float(2.0 * np.pi * bandwidth / brentq(excess, 1e-3, 10.0))


def make_servo(
    bandwidth: float,
    servo_rate: float,
    control_rate: float,
    damping: float,
    pole_ratio: float,
    *,
    feedforward: float = 0.0,
    limit: float | None = None,
) -> ServoConstants:
    """Constants for the integer multiple of ``control_rate`` (Hz) nearest to ``servo_rate`` (Hz); ``limit`` m."""
    substeps = max(1, round(servo_rate / control_rate))
    wn = natural_frequency(bandwidth, damping, pole_ratio)
    p = pole_ratio * wn
    period = 1.0 / (substeps * control_rate)
    system = np.zeros((4, 4))
    system[0, 1] = system[1, 2] = 1.0
    system[2] = [-p * wn**2, -(wn**2 + 2.0 * damping * wn * p), -(p + 2.0 * damping * wn), p * wn**2]
    closed = expm(system * period)
    system[2, 0] = 0.0  # the position acts through the limited error alone
    driven = expm(system * period)
    return ServoConstants(
        substeps=substeps,
        transition=np.ascontiguousarray(closed[:3, :3]),
        input=np.ascontiguousarray(closed[:3, 3]),
        # the held set-point is half a period ahead already
        lead=feedforward * (1.0 / p + 2.0 * damping / wn - 0.5 * period),
        limit=np.inf if limit is None else limit,
        open_transition=np.ascontiguousarray(driven[:3, :3]),
        open_input=np.ascontiguousarray(driven[:3, 3]),
        period=period,
    )


@kernel
def follow_targets(axes: Array, start: Array, end: Array, servo: ServoConstants) -> int:
    """Advance ``axes`` (A, 3) by one control tick while the targets move from ``start`` to ``end`` (A,) m.

    Returns a bit per axis whose controller saturated.
    """
    saturated = 0
    for k in range(axes.shape[0]):
        ahead = servo.lead * (end[k] - start[k]) / (servo.substeps * servo.period)
        for step in range(1, servo.substeps + 1):
            target = start[k] + step / servo.substeps * (end[k] - start[k]) + ahead
            x, v, a = axes[k, 0], axes[k, 1], axes[k, 2]
            error = target - x
            if servo.limit < np.inf:
                if abs(error) > servo.limit:
                    saturated |= 1 << k
                    error = min(max(error, -servo.limit), servo.limit)
                t, b = servo.open_transition, servo.open_input
                for m in range(3):
                    axes[k, m] = t[m, 0] * x + t[m, 1] * v + t[m, 2] * a + b[m] * error
            else:
                t, b = servo.transition, servo.input
                for m in range(3):
                    axes[k, m] = t[m, 0] * x + t[m, 1] * v + t[m, 2] * a + b[m] * target
    return saturated


UNEVEN = 1.0e-3
"""mm, by which a coordinate of an error map may be off an even grid: rounded to um."""


class ErrorMap(NamedTuple):
    """Errors (nx, ny, nz, 3) m on a regular grid: start, step (3,) m; a grid of one node in an axis does not vary."""

    start: Array
    step: Array
    error: Array


class AxisErrors(NamedTuple):
    """What stands between the encoders of six axes (x, y, z of tool 1, then of tool 2) and the true tips.

    Attributes
    ----------
    present : anything at all ; backlash : (6,) m, full play
    first : (7,) rows of axis k are first[k]:first[k + 1] ; place, error : (M,) m, all 1-D tables in one row
    map_1, map_2 : ErrorMap of each tool
    """

    present: bool
    backlash: Array
    first: NDArray[np.int64]
    place: Array
    error: Array
    map_1: ErrorMap
    map_2: ErrorMap


def make_axis_errors(rig: Rig) -> AxisErrors:
    """Errors of both tools of ``rig``; raises FILE_NOT_FOUND, FILE_SYNTAX or FILE_FIELD for a map."""
    tools = (rig.tool_1, rig.tool_2)
    tables = [table for tool in tools for table in (tool.error_x, tool.error_y, tool.error_z)]
    rows = [row for table in tables for row in table]
    backlash = np.array([*rig.tool_1.backlash, *rig.tool_2.backlash])
    maps = [_map_of(tool) for tool in tools]
    return AxisErrors(
        present=bool(rows or backlash.any() or any(item.error.any() for item in maps)),
        backlash=backlash,
        first=np.concatenate([[0], np.cumsum([len(table) for table in tables])]).astype(np.int64),
        place=np.array([place for place, _ in rows], dtype=np.float64),
        error=np.array([error for _, error in rows], dtype=np.float64),
        map_1=maps[0],
        map_2=maps[1],
    )


def read_error_map(path: Path) -> ErrorMap:
    """Map from a CSV file with one line of titles, then x, y, z in mm and ex, ey, ez in um on a complete grid.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, FILE_SYNTAX (not six columns of numbers), FILE_FIELD (not a complete regular grid)
    """
    columns = "a line of titles, then in each line x,y,z,ex,ey,ez"
    try:
        rows = [line for line in read_lines(path, LARGEST_TABLE)[1:] if line.strip()]
        table = np.loadtxt(rows, delimiter=",", ndmin=2) if rows else np.empty((0, 6))
    except FileNotFoundError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND,
            "no such error map",
            where=str(path),
            advice="the path is relative to the rig file",
        ) from error
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_SYNTAX, f"cannot be read: {error.strerror}", where=str(path), advice=columns
        ) from error
    except ValueError as error:
        raise IsfError(
            ErrorCode.FILE_SYNTAX, f"not a table of numbers: {error}", where=str(path), advice=columns
        ) from error
    if not len(table) or table.shape[1] != 6 or not np.isfinite(table).all():
        raise IsfError(
            ErrorCode.FILE_SYNTAX, "six columns of finite numbers are needed", where=str(path), advice=columns
        )
    axes = [np.unique(table[:, k]) for k in range(3)]
    shape = tuple(len(axis) for axis in axes)
    even = [np.linspace(axis[0], axis[-1], len(axis)) for axis in axes]
    regular = all(np.abs(axis - grid).max() <= UNEVEN for axis, grid in zip(axes, even, strict=True))
    errors = np.full((*shape, 3), np.nan)
    place = [np.searchsorted(axis, table[:, k]) for k, axis in enumerate(axes)]
    errors[place[0], place[1], place[2]] = 1e-6 * table[:, 3:]
    if len(table) != math.prod(shape) or not regular or not np.isfinite(errors).all():
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"{len(table)} rows are not a complete regular grid of {' x '.join(map(str, shape))}",
            where=str(path),
            advice="give every combination of the values of x, y and z, evenly spaced to 1 um, in one row",
        )
    return ErrorMap(
        start=1e-3 * np.array([axis[0] for axis in axes]),
        step=1e-3 * np.array([(axis[-1] - axis[0]) / (len(axis) - 1) if len(axis) > 1 else 1.0 for axis in axes]),
        error=errors,
    )


def _map_of(tool: ToolAxis) -> ErrorMap:
    if tool.error_map is None:
        return ErrorMap(np.zeros(3), np.ones(3), np.zeros((1, 1, 1, 3)))
    return read_error_map(Path(tool.error_map))


@kernel
def true_tips(encoder: Array, play: Array, errors: AxisErrors, tips: Array) -> None:
    """Write the true tips (2, 3) m for encoder positions (6,) m; ``play`` (6,) m is the driven side, updated."""
    for k in range(6):
        half = 0.5 * errors.backlash[k]
        play[k] = min(max(play[k], encoder[k] - half), encoder[k] + half)
    for tool in range(2):
        for k in range(3):
            axis = 3 * tool + k
            tips[tool, k] = play[axis] + _table(play[axis], axis, errors)
    _add_map(play[:3], errors.map_1, tips[0])
    _add_map(play[3:], errors.map_2, tips[1])


@kernel
def _table(position: float, axis: int, errors: AxisErrors) -> float:
    """m, linear between the rows of a 1-D table, constant beyond its ends."""
    first, end = errors.first[axis], errors.first[axis + 1]
    if first == end:
        return 0.0
    if position <= errors.place[first]:
        return errors.error[first]
    for k in range(first + 1, end):
        if position <= errors.place[k]:
            share = (position - errors.place[k - 1]) / (errors.place[k] - errors.place[k - 1])
            return errors.error[k - 1] + share * (errors.error[k] - errors.error[k - 1])
    return errors.error[end - 1]


@kernel
def _add_map(position: Array, error_map: ErrorMap, tip: Array) -> None:
    """Add the trilinear error at ``position`` (3,) m to ``tip`` (3,) m; constant beyond the grid."""
    low = np.empty(3, dtype=np.int64)
    share = np.empty(3)
    for k in range(3):
        nodes = error_map.error.shape[k]
        at = min(max((position[k] - error_map.start[k]) / error_map.step[k], 0.0), nodes - 1.0)
        low[k] = max(min(int(at), nodes - 2), 0)
        share[k] = at - low[k]
    for corner in range(8):
        weight = 1.0
        node = low.copy()
        for k in range(3):
            if corner >> k & 1:
                weight *= share[k]
                node[k] = min(low[k] + 1, error_map.error.shape[k] - 1)
            else:
                weight *= 1.0 - share[k]
        if weight > 0.0:
            for k in range(3):
                tip[k] += weight * error_map.error[node[0], node[1], node[2], k]
