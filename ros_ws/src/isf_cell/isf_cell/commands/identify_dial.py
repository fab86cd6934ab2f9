"""``isf identify --dial FILE``: compliance of the tools from readings of a dial indicator."""

from __future__ import annotations

import csv
import json
from datetime import date
from pathlib import Path

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_lines
from isf_core.files.rig import load_rig
from isf_identify.dial_indicator import AXES, DialTable, dial_piece, far_from, fit_dial, without_arms
from isf_identify.rig_piece import arm_part
from rich.markup import escape

from isf_cell.commands import terminal

UNITS = {"deflection_um": 1e-6, "deflection_mm": 1e-3}
NEEDED = ("tool", "axis", "force_N")
_ADVICE = "columns tool (1, 2), axis (x, y, z), place, repeat (both may be left out), force_N, deflection_um or _mm"


def identify_dial(path: Path, rig: str, piece: Path, *, as_json: bool) -> None:
    """Fit the table ``path`` and write ``piece``, a rig file on top of ``rig`` (name or absolute path)."""
    table, column = read_dial(path)
    found, refused = fit_dial(table)
    below = load_rig(rig)
    present = {1: np.array(below.tool_1.compliance), 2: np.array(below.tool_2.compliance)}
    arms = {tool: arm_part(below, tool) for tool in (1, 2)}
    far = far_from(found, {tool: present[tool] + arms[tool] for tool in (1, 2)}, column)
    found, hidden = without_arms({pair: item for pair, item in found.items() if pair not in far}, arms)
    if not found:
        raise next(iter((far | hidden).values()))
    refused |= far | hidden
    name = json.dumps(piece.stem, ensure_ascii=False)
    text = f"name: {name}\n" + dial_piece(rig, date.today().isoformat(), found, present, refused)
    try:
        piece.write_text(text, encoding="utf-8")
    except OSError as error:
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(piece)) from None
    heads = ("", "value [µm/N]", "standard deviation [µm/N]", "places", "readings left out", "constant")
    shown = terminal.table_of("compliance by dial indicator", *heads)
    values: dict[str, object] = {}
    for (tool, axis), item in found.items():
        name = f"tool_{tool}.{AXES[axis]}"
        constant = "yes" if item.constant else "no"
        cells = (f"{1e6 * item.value:.4g}", f"{1e6 * item.deviation:.2g}", str(len(item.places)), str(item.rejected))
        shown.add_row(name, *cells, constant)
        values[name] = {
            "value": item.value,
            "uncertainty": item.deviation,
            "per_place": item.per_place.tolist(),
            "rejected": item.rejected,
            "residual": item.residual,
            "constant": item.constant,
        }
    if as_json:
        terminal.print_json(
            {
                "property": "TOOL_COMPLIANCE",
                "by": "dial indicator",
                "values": values,
                "refused": {f"tool_{tool}.{AXES[axis]}": error.message for (tool, axis), error in refused.items()},
                "rig": str(piece),
            }
        )
    terminal.console.print(shown)
    for reason in refused.values():
        terminal.console.print(f"[yellow]refused, the rig's value is kept:[/] {escape(reason.message)}")
    terminal.say(f"rig file {piece}")


def read_dial(path: Path) -> tuple[DialTable, str]:
    """Table of readings (CSV with a header, # for remarks) and the column of the deflection; raises IsfError naming
    file and row."""
    try:
        lines = read_lines(path)
    except FileNotFoundError:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice="check the path") from None
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
        raise IsfError(ErrorCode.FILE_SYNTAX, what, where=str(path), advice=_ADVICE) from None
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    header = [name.strip() for name in numbered[0][1].split(",")] if numbered else []
    unit = next((name for name in UNITS if name in header), None)
    if unit is None or any(name not in header for name in NEEDED):
        raise IsfError(ErrorCode.FILE_FIELD, "a column is missing", where=str(path), advice=_ADVICE)
    rows = []
    for (number, _), cells in zip(numbered[1:], csv.reader(line for _, line in numbered[1:]), strict=True):
        where = f"{path}: row {number}"
        if len(cells) != len(header):
            raise IsfError(ErrorCode.FILE_SYNTAX, f"{len(cells)} values, {len(header)} columns", where=where)
        item = dict(zip(header, (cell.strip() for cell in cells), strict=True))
        try:
            numbers = (
                int(item["tool"]),
                AXES.index(item["axis"]),
                int(item.get("place", 1)),
                int(item.get("repeat", 1)),
            )
            row = (*numbers, float(item["force_N"]), UNITS[unit] * float(item[unit]))
        except ValueError:
            raise IsfError(ErrorCode.FILE_SYNTAX, "not a reading", where=where, advice=_ADVICE) from None
        if row[0] not in (1, 2) or not np.isfinite(row).all():
            raise IsfError(ErrorCode.FILE_FIELD, "not a reading", where=where, advice=_ADVICE)
        rows.append(row)
    if not rows:
        raise IsfError(ErrorCode.FILE_FIELD, "holds no readings", where=str(path), advice=_ADVICE)
    table = np.array(rows)
    tool, axis, place, repeat = (table[:, k].astype(np.int64) for k in range(4))
    return DialTable(tool, axis, place, repeat, table[:, 4], table[:, 5]), unit
