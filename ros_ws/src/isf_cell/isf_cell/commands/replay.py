"""``isf replay``: a recorded part decided again, and formed again, with the same or with other parameters."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.figures import replay_figures, style
from isf_analysis.measures.force_metrics import rms_by_contour
from rich.markup import escape

from isf_cell.commands import terminal
from isf_cell.commands.run_folder import make_run_folder
from isf_cell.replay.outcome import BY_CLOCK, Replay, replay
from isf_cell.replay.recorded_run import read_run
from isf_cell.replay.what_if import parse


def replay_run(
    path: Path,
    changes: Sequence[str],
    output: Path | None,
    base: Path | None,
    replant: bool | None,
    *,
    namespace: str | None = None,
    as_json: bool,
) -> None:
    """Replay the run or bag at ``path`` with the ``changes`` "NAME=VALUE"; pictures where there are changes.

    ``namespace`` of the cell, where the bag holds several.

    Raises IsfError BAG_UNREADABLE, BAG_INCOMPLETE, FILE_FIELD, and codes of the job.
    """
    what_if = parse(changes)
    run = read_run(path, namespace)
    with terminal.part_progress(f"{run.part.job_name}, replayed") as progress:
        found = replay(run, what_if, base=base, replant=replant, phase=progress.phase, formed=progress.contour)
    data = found.numbers()
    if what_if or output is not None:
        folder = make_run_folder(output, f"replay-{run.part.job_name}")
        data |= _write(found, data, folder)
    if as_json:
        terminal.print_json(data)
    _show(found, data)


def _write(found: Replay, data: dict[str, Any], folder: Path) -> dict[str, str]:
    """Picture, table and numbers in ``folder``; their paths."""
    part, again = found.run.part, found.again if found.what_if else None
    files = {"picture": str(folder / "replay.png"), "table": str(folder / "contours.csv")}
    with style.applied():
        figure = replay_figures.what_if(part, again, found.corrections, found.moved)
        Path(files["picture"]).write_bytes(style.png(figure))
    with Path(files["table"]).open("w", encoding="utf-8", newline="") as stream:
        rows = list(_rows(found))
        writer = csv.DictWriter(stream, list(rows[0]) if rows else ["contour"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    text = json.dumps(terminal.without_nan({**data, **files}), indent=2)
    (folder / "replay.json").write_text(text, encoding="utf-8")
    return files


def _rows(found: Replay) -> list[dict[str, Any]]:
    """One row per contour."""
    part = found.run.part
    forming, support = ({int(row[0]): 1e6 * row[column] for row in found.moved} for column in (1, 2))
    decided = {item.index: item for item in found.corrections or ()}
    recorded = {item.index: item for item in part.corrections}
    before, after = (
        rms_by_contour(record.results, record.control_rate) if record is not None else {}
        for record in (part, found.again)
    )
    rows = []
    for contour in part.nominal:
        k = contour.index
        rows.append(
            {
                "contour": k,
                "recorded_force_error_rms_N": before.get(k),
                "what_if_force_error_rms_N": after.get(k),
                "forming_tip_moved_um": forming.get(k),
                "support_tip_moved_um": support.get(k),
                "recorded_correction_mean_mm": _mean(recorded.get(k)),
                "decided_correction_mean_mm": _mean(decided.get(k)),
            }
        )
    return rows


def _mean(correction: Any) -> float | None:
    return None if correction is None else 1e3 * float(np.linalg.norm(correction.offset, axis=1).mean())


def _show(found: Replay, data: dict[str, Any]) -> None:
    say = terminal.say
    targets = data["targets"]
    if found.what_if:
        say(f"what if {', '.join(f'{name} = {value}' for name, value in found.what_if.given.items())}")
    if targets is not None and (found.what_if or found.how == BY_CLOCK):
        support, forming = (data["moved"][f"{name}_tip_largest_um"] for name in ("support", "forming"))
        say(
            f"force control, fed with the recorded forces: at the same points the support tool is up to {support:.1f} "
            f"um elsewhere, the forming tool {forming:.1f} um"
        )
    elif targets is not None:
        say(
            f"force control, fed with {targets['compared']} recorded ticks: {targets['differing']} targets differ, "
            f"by at most {targets['largest_um']:.3f} um"
            + (f"; {targets['not_replayed']} not replayed" if targets["not_replayed"] else "")
        )
    if found.corrections is not None:
        largest = data["corrections"]["largest_mm"]
        say(f"springback, fed with what was measured: corrections differ by at most {largest:.4f} mm")
    if not found.what_if:
        word = {True: "true", False: "false", None: "cannot be known"}[found.identical]
        say(f"identical: {word}" + (f" ({found.how})" if found.how else ""))
        if found.identical is False and data["results"]:
            for name, size in data["results"]["differing_fields"].items():
                say(f"  results differ in {name}, by at most {size:g} (SI)")
    if data["prediction"]:
        _show_prediction(data["prediction"])
    elif found.what_if and not found.run.simulated:
        say("what the sheet would have answered cannot be told: a real part is not formed again")
    for note in found.notes:
        terminal.warn(note)
    if "picture" in data:
        say(f"picture {data['picture']}")


def _show_prediction(prediction: dict[str, Any]) -> None:
    table = terminal.table_of("formed again on the simulated machine", "", "recorded", "what if")
    rows = (
        ("force error rms [N]", "force_error_rms_N", 2),
        ("force error largest [N]", "force_error_max_N", 1),
        ("engaged time within 10 N", "within_10N_fraction", 4),
        ("contact", "contact_fraction", 4),
        ("mean error of the shape [mm]", "error_mean_mm", 3),
        ("largest error of the shape [mm]", "error_max_mm", 3),
        ("points in tolerance", "within_tolerance_fraction", 3),
        ("forming time [s]", "forming_time_s", 1),
        ("gain lowered, times", "backoffs", 0),
        ("events", "events", 0),
    )
    for label, key, digits in rows:
        values = [prediction[which][key] for which in ("recorded", "what_if")]
        table.add_row(escape(label), *("-" if value is None else f"{value:.{digits}f}" for value in values))
    terminal.console.print(table)
