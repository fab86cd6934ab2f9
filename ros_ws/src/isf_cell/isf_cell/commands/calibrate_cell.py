"""``isf calibrate-cell``: a load cell's matrix or gains from a table of known loads."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_lines
from isf_core.types import Array
from isf_load_cell.calibration import fit_channel, fit_matrix

from isf_cell.commands import terminal

MAXIMUM_GAIN, MAXIMUM_CONDITION = 3.0, 1e3
"""A rig's readings are N and N m: gains further from 1 are another unit; a matrix worse than this has no inverse."""

_ADVICE = "a header such as fx,fy,fz,u1,u2,u3 (matrix) or load,X,Y,Z (one line per channel), then one row per load"


def calibrate_file(path: Path, limit: float | None, output: Path | None, *, as_json: bool) -> None:
    """Fit ``path``: columns fx, fy, ... are loads in N and the others readings; a column "load" fits every channel.

    ``limit`` N leaves out greater loads; the piece of a rig file goes to ``output``. Raises IsfError.
    """
    names, table = _read(path)
    if "load" in names:
        data, text = _channels(names, table, limit)
    else:
        data, text = _matrix(names, table, limit, path)
    if output is not None:
        try:
            output.write_text(text, encoding="utf-8")
        except OSError as error:
            raise IsfError(ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(output)) from None
    if as_json:
        terminal.print_json(data)
    terminal.say(text)


def _read(path: Path) -> tuple[list[str], Array]:
    try:
        lines = [line for line in read_lines(path) if line and not line.startswith("#")]
    except FileNotFoundError:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice="check the path") from None
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        raise IsfError(ErrorCode.FILE_SYNTAX, what, where=str(path), advice=_ADVICE) from None
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            row = [float(cell) for cell in line.split(",")]
            if not all(map(math.isfinite, row)):
                raise ValueError
        except ValueError:
            raise IsfError(
                ErrorCode.FILE_SYNTAX, "not a finite number", where=f"{path}: row {number}", advice=_ADVICE
            ) from None
        if len(row) != len(names):
            raise IsfError(
                ErrorCode.FILE_SYNTAX, f"{len(row)} values, {len(names)} columns", where=f"{path}: row {number}"
            )
        rows.append(row)
    if len(rows) < 3 or len(set(names)) != len(names):
        raise IsfError(ErrorCode.FILE_FIELD, "needs a header and three rows or more", where=str(path), advice=_ADVICE)
    return names, np.array(rows)


def _matrix(names: list[str], table: Array, limit: float | None, path: Path) -> tuple[dict[str, Any], str]:
    loads: list[str] = [name for name in ("fx", "fy", "fz", "tx", "ty", "tz") if name in names]
    channels = [name for name in names if name not in loads]
    if not loads or not channels:
        raise IsfError(ErrorCode.FILE_FIELD, "no columns of loads or readings", where=str(path), advice=_ADVICE)
    load = table[:, [names.index(name) for name in loads]]
    keep = np.linalg.norm(load, axis=1) <= (np.inf if limit is None else limit)
    fit = fit_matrix(load[keep], table[keep][:, [names.index(name) for name in channels]])
    used = ~fit.rejected
    rms = np.sqrt((fit.residual[used] ** 2).mean(axis=0))
    data = {
        "loads": loads,
        "channels": channels,
        "matrix": fit.matrix.tolist(),
        "uncertainty": fit.uncertainty.tolist(),
        "zero": fit.zero.tolist(),
        "residual_rms": rms.tolist(),
        "residual_max": np.abs(fit.residual[used]).max(axis=0).tolist(),
        "rejected_rows": (np.flatnonzero(keep)[fit.rejected] + 2).tolist(),
    }
    text = (
        f"# fitted to {int(used.sum())} loads; residuals (rms) "
        + ", ".join(f"{name} {value:.3g} {_unit(name)}" for name, value in zip(loads, rms, strict=True))
        + f"; rejected rows: {data['rejected_rows'] or 'none'}\n"
        + f"# {', '.join(f'{name} [{_unit(name)}]' for name in loads)} per unit of {', '.join(channels)}; "
        + "readings without load, in their unit: "
        + ", ".join(f"{value:.6g}" for value in fit.zero)
    )
    response = _response(fit.matrix, loads)
    if response is None:
        text += "\n# for the cell's driver: load = calibration_matrix (reading - reading without load); not for a rig"
        text += f"\ncalibration_matrix:\n{_lines(fit.matrix, '  ')}\n"
    else:
        data["rig_matrix"] = response.tolist()
        text += "\n# reading = matrix load, for load_cell of a rig file; for the cell's driver its inverse:\n"
        text += _lines(fit.matrix, "#   ") + f"\nload_cell:\n  matrix:\n{_lines(response, '    ')}\n"
    return data, text


def _unit(load: str) -> str:
    """Unit of a column of loads."""
    return "N" if load.startswith("f") else "N m"


def _response(matrix: Array, loads: list[str]) -> Array | None:
    """(6, 6) readings per load as in ``load_cell.matrix`` of a rig; None for readings that are not in N and N m.

    ``matrix`` is that of :class:`MatrixCalibration`, its inverse. Torques that were not loaded read as they are.
    """
    count = len(loads)
    if loads != ["fx", "fy", "fz", "tx", "ty", "tz"][:count] or count not in (3, 6) or matrix.shape != (count, count):
        return None
    if np.linalg.cond(matrix) > MAXIMUM_CONDITION:
        return None
    response = np.eye(6)
    response[:count, :count] = np.linalg.inv(matrix)
    gain = np.diag(response)
    return response if ((gain > 1.0 / MAXIMUM_GAIN) & (gain < MAXIMUM_GAIN)).all() else None


def _lines(matrix: Array, indent: str) -> str:
    """Rows of a YAML list."""
    return "\n".join(f"{indent}- [" + ", ".join(f"{value:.6g}" for value in line) + "]" for line in matrix)


def _channels(names: list[str], table: Array, limit: float | None) -> tuple[dict[str, Any], str]:
    load = table[:, names.index("load")]
    data: dict[str, Any] = {}
    lines = ["# straight lines, load = gain * reading + offset; N per unit of the reading", "calibration_gains:"]
    for name in (name for name in names if name != "load"):
        fit = fit_channel(load, table[:, names.index(name)], largest=limit)
        within = np.abs(load) <= (np.inf if limit is None else limit)
        slips = np.flatnonzero(fit.rejected & within)
        worst = float(np.abs(fit.residual[~fit.rejected]).max())
        data[name] = {
            "gain": fit.gain,
            "offset": fit.offset,
            "r_squared": fit.r_squared,
            "residual_max": worst,
            "rejected_loads": load[slips].tolist(),
        }
        slip = f"; rejected loads: {load[slips].tolist()}" if len(slips) else ""
        lines.append(
            f"  {name}: {fit.gain:.1f}  # offset {fit.offset:.1f} N, R2 {fit.r_squared:.4f}, worst {worst:.0f} N{slip}"
        )
    return data, "\n".join(lines) + "\n"
