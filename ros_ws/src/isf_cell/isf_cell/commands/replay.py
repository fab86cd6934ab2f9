"""``isf replay``: a recorded part decided again, and formed again, with the same or with other parameters."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.bag.open_bag import bag_of
from isf_analysis.figures import replay_figures, style
from isf_analysis.measures.force_metrics import rms_by_contour
from isf_core.contour import contour_label
from isf_core.errors import ErrorCode, IsfError
from rich.markup import escape

from isf_cell.commands import terminal
from isf_cell.commands.resume import being_formed
from isf_cell.commands.run_folder import run_folder
from isf_cell.processes.ctrl_c import ctrl_c_held_back
from isf_cell.replay.differences import Difference
from isf_cell.replay.outcome import BY_CLOCK, Replay, replay
from isf_cell.replay.recorded_run import RecordedRun, read_run
from isf_cell.replay.what_if import WhatIf, parse

FORMED_AGAIN = "formed again"
"""What the part is called that was formed again without a change."""


def replay_run(
    path: Path,
    changes: Sequence[str],
    output: Path | None,
    base: Path | None,
    replant: bool | None,
    *,
    namespace: str | None = None,
    from_contour: int | None = None,
    as_json: bool,
) -> None:
    """Replay the run or bag at ``path`` with the ``changes`` "NAME=VALUE"; pictures where there are changes.

    ``namespace`` of the cell, where the bag holds several. ``from_contour`` : the part is formed again, and the changes
    hold from this contour (from 1) on.

    Raises IsfError BAG_UNREADABLE, BAG_INCOMPLETE, FILE_FIELD, FILE_NOT_WRITABLE, BUSY, and codes of the job.
    """
    what_if = parse(changes)
    start = None if from_contour is None else from_contour - 1
    if start is not None:
        what_if.check_mid_part()
        _check_not_being_formed(bag_of(path).parent)
    try:
        found, data = _replayed(read_run(path, namespace), what_if, output, base, replant, start)
    except KeyboardInterrupt:
        raise IsfError(
            ErrorCode.CANCELLED, "stopped by the operator; the record is as it was", where=str(path)
        ) from None
    if as_json:
        terminal.print_json(data)
    _show(found, data)


def _replayed(
    run: RecordedRun, what_if: WhatIf, output: Path | None, base: Path | None, replant: bool | None, start: int | None
) -> tuple[Replay, dict[str, Any]]:
    """The replay and its numbers; files where there are changes or ``output``, all of them or none."""
    with ExitStack() as stack:
        folder = None
        if what_if or output is not None:
            folder = stack.enter_context(run_folder(output, f"replay-{run.part.job_name}"))
        with terminal.part_progress(f"{run.part.job_name}, replayed") as progress:
            found = replay(
                run, what_if, base=base, replant=replant, start=start, phase=progress.phase, formed=progress.contour
            )
        data = found.numbers()
        if folder is not None:
            stack.enter_context(ctrl_c_held_back())
            data |= _write(found, data, folder)
    return found, data


def _check_not_being_formed(run: Path) -> None:
    if being_formed(run):
        raise IsfError(
            ErrorCode.BUSY,
            "another command forms this part: what comes after a contour is not recorded yet",
            where=str(run),
            advice="wait until it ends; without --from what is recorded so far is replayed",
        )


def _write(found: Replay, data: dict[str, Any], folder: Path) -> dict[str, str]:
    """Picture, table and numbers in ``folder``; their paths."""
    part, again = found.run.part, found.again if found.what_if or found.start is not None else None
    files = {"picture": str(folder / "replay.png"), "table": str(folder / "contours.csv")}
    name = replay_figures.WHAT_IF if found.what_if else FORMED_AGAIN
    with style.applied():
        figure = replay_figures.what_if(part, again, found.corrections, found.moved, name, found.start)
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
    again = found.again.corrections if found.again is not None else ()
    decided = {item.index: item for item in found.corrections or again}
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
                "changed": int(bool(found.what_if) and k >= (found.start or 0)),
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


def _other(found: Replay) -> str:
    """What the part that was formed again is called beside the recorded one."""
    if not found.what_if:
        return FORMED_AGAIN
    return replay_figures.WHAT_IF if found.start is None else f"from contour {found.start + 1} with {_changes(found)}"


def _changes(found: Replay) -> str:
    return ", ".join(f"{name} = {value}" for name, value in found.what_if.given.items())


def _show(found: Replay, data: dict[str, Any]) -> None:
    say = terminal.say
    targets = data["targets"]
    if found.what_if and found.start is None:
        say(f"what if {_changes(found)}")
    if (before := found.before) is not None:
        _show_before(before, found)
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
        how = found.identical_unknown or found.how
        say(f"identical: {word}" + (f" ({how})" if how else ""))
        if found.identical is False and data["results"]:
            for name, size in data["results"]["differing_fields"].items():
                say(f"  results differ in {name}, by at most {size:g} (SI)")
    elif found.start is not None and found.identical:
        say("identical: true: the changes have no effect on this part")
    if data["prediction"]:
        _show_prediction(data["prediction"], found)
    elif found.what_if and not found.run.simulated:
        say("what the sheet would have answered cannot be told: a real part is not formed again")
    for note in found.notes:
        terminal.warn(note)
    if "picture" in data:
        say(f"picture {data['picture']}")


def _show_before(before: Difference, found: Replay) -> None:
    """Whether the contours before the changes are the recorded ones."""
    assert found.start is not None  # else there is nothing before it
    contours = "contour 1" if found.start == 1 else f"contours 1 to {found.start}"
    if before.identical:
        terminal.say(f"{contours} formed again as recorded: the same bit for bit")
        return
    first = "some are in one alone" if before.first is None else f"they differ from {contour_label(before.first)} on"
    why = f" ({found.identical_unknown})" if found.identical_unknown else ""
    terminal.warn(
        f"{contours} formed again are not those of the record, {first}{why}: what comes after is not that of the "
        "changes alone"
    )


def _show_prediction(prediction: dict[str, Any], found: Replay) -> None:
    title = "formed again on the simulated machine"
    if found.span:
        title += f"; force and time of contours {found.span[0] + 1} to {found.span[-1] + 1}"
    table = terminal.table_of(title, "", "recorded", _other(found))
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
