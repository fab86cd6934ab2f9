"""``isf springback compare``: one part formed with several methods in this process."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from isf_analysis.measures.deviation import Deviation, compare
from isf_analysis.measures.record import PartRecord
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import torn
from isf_core.files.job import AUTO, load_job, springback_method
from isf_core.simulated_sheet import SEALED_VARIANTS
from isf_planner import plan
from isf_springback.methods import check_name
from rich.table import Table

from isf_cell import in_process
from isf_cell.commands import terminal
from isf_cell.commands.elastic_database import prepare_database
from isf_cell.commands.run_folder import make_run_folder
from isf_cell.commands.springback_figures import draw_comparison
from isf_cell.options import RunOptions


def compare_methods(
    job: Path, methods: list[str], variant: int, seed: int, output: Path | None, *, as_json: bool
) -> None:
    """Form ``job`` once with each of ``methods``; raises IsfError when a method or the plan fails.

    A part that ends early keeps its row, with its code.
    """
    if not methods:
        raise IsfError(
            ErrorCode.METHOD_UNKNOWN, "no method is named", where="--methods", advice="for example: none,elastic"
        )
    for name in methods:
        check_name(name, "--methods")
    job_file = load_job(job)
    if AUTO in methods:
        terminal.say(f"auto is {springback_method(job_file.job, AUTO)} here")
    methods = list(dict.fromkeys(springback_method(job_file.job, name) for name in methods))
    folder = make_run_folder(output, f"compare-{job_file.job.name}")
    with terminal.console.status("planning"):
        part_plan = plan(job_file)
    records: dict[str, PartRecord] = {}
    for name in methods:
        options = RunOptions(correction=name, variant=variant, seed=seed)
        with terminal.part_progress(f"{job_file.job.name} ({name})") as progress:
            prepare_database(job_file, name, progress.phase, part_plan.contours)
            records[name] = in_process.form(job_file, options, part_plan=part_plan, progress=progress.contour)
    deviations = {name: _deviation(record) for name, record in records.items()}
    rows = [_row(name, records[name], deviations[name]) for name in methods]
    _write(rows, folder / "methods.csv")
    picture = draw_comparison(records, deviations, folder / "methods.png")
    data = {
        "job": job_file.job.name,
        "variant": variant,
        "sealed": variant in SEALED_VARIANTS,
        "seed": seed,
        "methods": rows,
        "picture": str(picture),
    }
    if as_json:
        terminal.print_json(data)
    terminal.console.print(_table(job_file.job.name, rows))
    terminal.say(f"picture {picture}\ntable   {folder / 'methods.csv'}")


def _deviation(record: PartRecord) -> Deviation | None:
    if record.scan is None or record.target is None:
        return None
    return compare(record.scan, record.target)


def _row(name: str, record: PartRecord, deviation: Deviation | None) -> dict[str, Any]:
    """Numbers of one method; mm, N, ms."""
    last, lost = record.results[-1], torn(record.events)  # a completed contour may carry the code of a warning
    row: dict[str, Any] = {
        "method": name,
        "contours": len(record.results),
        "code": int(lost.code) if lost else 0 if last.completed else int(last.code),
    }
    for region in ("wall_and_base", "wall", "base", "rim"):
        errors = None if deviation is None else deviation.regions[region]
        row[f"{region}_max_mm"] = None if errors is None else 1e3 * errors.max_abs
        row[f"{region}_mean_mm"] = None if errors is None else 1e3 * errors.mean_abs
        row[f"{region}_signed_mm"] = None if errors is None else 1e3 * errors.mean
    row["largest_correction_mm"] = 1e3 * max(float(abs(c.offset).max()) for c in record.corrections)
    row["slowest_correction_ms"] = 1e3 * max(c.solve_time for c in record.corrections)
    return row


def _write(rows: list[dict[str, Any]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _table(job: str, rows: list[dict[str, Any]]) -> Table:
    quantities = ("max", "mean", "base, signed", "rim, max", "correction, max")
    heads = (*(f"{quantity} [mm]" for quantity in quantities), "slowest correction [ms]")
    table = terminal.table_of(f"{job}: formed minus target", "method", *heads)
    keys = ("wall_and_base_max", "wall_and_base_mean", "base_signed", "rim_max", "largest_correction")
    for row in rows:
        values = ["-" if row[f"{key}_mm"] is None else f"{row[f'{key}_mm']:.2f}" for key in keys]
        ended = f" (ended early, code {row['code']})" if row["code"] else ""
        table.add_row(row["method"] + ended, *values, f"{row['slowest_correction_ms']:.0f}")
    return table
