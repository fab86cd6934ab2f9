"""``isf campaign``: jobs, methods, variants and sheets simulated on all cores, into one table and one page.

Every part is a line of ``rows.jsonl``, named by what its numbers depend on: a campaign that was stopped goes on, and a
part of another job or of other sources is formed again.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from isf_analysis.bag.table_files import write_table
from isf_analysis.measures.campaign_row import CampaignRow, columns_of, row_from
from isf_analysis.report.campaign_page import Formed, campaign_page, grouped, picture_of
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.campaign import CampaignFile
from isf_springback.database.database import cached_path
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from isf_cell.campaign.cases import Case, cases_of, form_case
from isf_cell.campaign.content import sources
from isf_cell.campaign.rows_file import append_row, read_rows, sole_writer
from isf_cell.commands import terminal
from isf_cell.commands.elastic_database import prepare_database, takes_database
from isf_cell.commands.exit_codes import ReportedError
from isf_cell.commands.run_folder import make_folder
from isf_cell.processes.part_pool import formed_beside

ROWS, TABLE, PAGE, PICTURE = "rows.jsonl", "campaign", "campaign.html", "errors.png"


@dataclass(frozen=True)
class Found:
    """What a folder holds of a campaign; cases of equal content have one part, whatever they are called.

    Attributes
    ----------
    cases : all ; rows : of those that are there, by key ; stale : parts that were formed of another job or by other
        sources, and are formed again
    """

    cases: Sequence[Case]
    rows: dict[str, CampaignRow]
    stale: int

    @property
    def ordered(self) -> list[CampaignRow]:
        """Rows in the order of the cases; what is refused has one without being formed."""
        return [row for case in self.cases if (row := self.row_of(case)) is not None]

    @property
    def missing(self) -> list[Case]:
        """Cases to be formed, one of each content."""
        found: dict[str, Case] = {}
        for case in self.cases:
            if self.row_of(case) is None:
                found.setdefault(case.row.key, case)
        return list(found.values())

    def row_of(self, case: Case) -> CampaignRow | None:
        """Row of a case, by the names of its own; None while it is not formed."""
        if case.row.code:
            return case.row
        row = self.rows.get(case.row.key)
        return None if row is None else replace(row, job=case.row.job, method=case.row.method)


def run_campaign(path: Path, output: Path | None, processes: int, *, as_json: bool) -> None:
    """Form what is missing of the campaign in ``path`` and write table and page.

    Raises
    ------
    IsfError : what the campaign file or one of its jobs is refused for, FILE_NOT_WRITABLE for a folder of something
    else, BUSY for one that another campaign writes to, CANCELLED by Ctrl-C; what was formed is kept and shown then
    """
    file = CampaignFile(path)
    digest = sources()
    cases = cases_of(file, digest)
    folder = _folder(output or Path("runs") / f"campaign-{file.campaign.name}")
    rows_file = folder / ROWS
    with sole_writer(rows_file):
        found = _found(cases, read_rows(rows_file))
        _say_beginning(found, digest, folder)
        failure = None
        try:
            _databases(found.missing)
            _form_missing(found, rows_file, processes)
        except KeyboardInterrupt:
            count = f"{len(found.ordered)} of {len(cases)} parts are kept"
            advice = "the same command goes on with them"
            failure = IsfError(
                ErrorCode.CANCELLED, f"stopped by the operator; {count}", where=str(folder), advice=advice
            )
        except IsfError as error:
            failure = error
        files = _written(file, found, folder, processes)
        if as_json:
            terminal.print_json(_json(file, found, digest, files, failure))
        _show(found.ordered)
        terminal.say("\n".join(f"{name:<8}{at}" for name, at in files.items()))
    if failure is not None:
        raise ReportedError(failure)


def _folder(folder: Path) -> Path:
    """Of this campaign, new or begun earlier."""
    made = make_folder(folder)
    if any(made.iterdir()) and not (made / ROWS).exists():
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, "is not empty", where=str(folder), advice="choose another --output")
    return made


def _found(cases: Sequence[Case], kept: dict[str, dict[str, Any]]) -> Found:
    wanted = {case.row.key for case in cases}
    rows = {key: row for key, data in kept.items() if key in wanted and (row := row_from(data)) is not None}
    names = ("job", "method", "variant", "seed", "sheet")
    before = {tuple(data.get(name) for name in names) for key, data in kept.items() if key not in rows}
    of_this = [tuple(getattr(case.row, name) for name in names) for case in cases if case.row.key not in rows]
    return Found(cases, rows, sum(name in before for name in of_this))


def _say_beginning(found: Found, digest: str, folder: Path) -> None:
    terminal.say(f"{len(found.ordered)} of {len(found.cases)} parts are there; sources {digest}; {folder}")
    refused = [case for case in found.cases if case.row.code]
    if found.stale:
        terminal.warn(
            f"{found.stale} parts were formed of a job that has changed or by another version of this software: they "
            "are formed again"
        )
    for title in dict.fromkeys(f"{case.row.job} with {case.row.method}: {case.row.message}" for case in refused):
        terminal.warn(title)


def _databases(missing: Sequence[Case]) -> None:
    """Databases of the elastic shell, so that parts that stand side by side do not compute each its own."""
    with terminal.part_progress("databases") as progress:
        jobs = [case.job_file for case in missing]
        taking = [job_file for job_file in jobs if takes_database(job_file, job_file.job.springback.method)]
        for job_file in {cached_path(job_file): job_file for job_file in taking}.values():
            prepare_database(job_file, job_file.job.springback.method, progress.phase)


def _form_missing(found: Found, rows_file: Path, processes: int) -> None:
    missing = found.missing
    if not missing:
        return
    with _progress(len(missing)) as advance:
        for case, data in formed_beside(form_case, missing, processes):
            append_row(rows_file, data)
            row = row_from(data)
            assert row is not None
            found.rows[row.key] = row
            advance(_told(case, row))


def _told(case: Case, row: CampaignRow) -> str:
    if not row.whole:
        return f"{case.title}: {row.ending}"
    return f"{case.title}: {row.max_mm:.2f} / {row.mean_mm:.2f} mm, {row.wall_s:.0f} s"


@contextmanager
def _progress(total: int) -> Iterator[Any]:
    """Progress of ``total`` parts: a line for each with the time that is left, and a bar in a terminal."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    started, done = time.monotonic(), 0
    console = terminal.console
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as progress:
        task = progress.add_task("parts", total=total)

        def advance(text: str) -> None:
            nonlocal done
            done += 1
            left = (time.monotonic() - started) / done * (total - done)
            progress.update(task, completed=done, description=f"parts, {_left(left)}")
            terminal.say(f"  {done}/{total} {text}" + (f"; {_left(left)}" if done < total else ""))

        yield advance


def _left(seconds: float) -> str:
    if seconds < 90:
        return f"about {seconds:.0f} s left"
    return f"about {seconds / 60:.0f} min left" if seconds < 5400 else f"about {seconds / 3600:.1f} h left"


def _written(file: CampaignFile, found: Found, folder: Path, processes: int) -> dict[str, Path]:
    """Table and page of the rows there are; their names and paths."""
    rows = found.ordered
    files: dict[str, Path] = {}
    if not rows:
        return files
    for path in write_table(columns_of(rows), folder, TABLE):
        files[path.suffix.removeprefix(".")] = path
    picture = picture_of(rows)
    page = campaign_page(file.campaign.name, rows, len(found.cases), file.text, processes, picture)
    try:
        if picture is not None:
            (folder / PICTURE).write_bytes(picture)
            files["picture"] = folder / PICTURE
        (folder / PAGE).write_text(page, encoding="utf-8")
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(folder), advice="choose a writable --output"
        ) from error
    files["page"] = folder / PAGE
    return files


def _json(
    file: CampaignFile, found: Found, digest: str, files: dict[str, Path], failure: IsfError | None
) -> dict[str, Any]:
    rows = found.ordered
    data: dict[str, Any] = {
        "campaign": file.campaign.name,
        "parts": len(found.cases),
        "formed": len(rows),
        "whole": sum(row.whole for row in rows),
        "stale": found.stale,
        "seed": file.campaign.seed,
        "sources": digest,
        "methods": [_method(group) for group in grouped(rows)],
        "files": {name: str(path) for name, path in files.items()},
    }
    if failure is not None:
        data["error"] = terminal.error_data(failure)
    return data


def _method(group: Formed) -> dict[str, Any]:
    nominal, worst = group.nominal, group.worst
    return {
        "job": group.job,
        "method": group.method,
        "sheet": group.sheet,
        "parts": len(group.rows),
        "whole": len(group.whole),
        "codes": sorted({row.code for row in group.failures}),
        "nominal_max_mm": nominal.max_mm if nominal else None,
        "nominal_mean_mm": nominal.mean_mm if nominal else None,
        "median_max_mm": group.median("max_mm"),
        "median_mean_mm": group.median("mean_mm"),
        "worst_max_mm": worst.max_mm if worst else None,
        "worst_variant": worst.variant if worst else None,
        "expected_known": len(group.told),
        "overconfident": group.overconfident,
    }


def _show(rows: Sequence[CampaignRow]) -> None:
    heads = ("job", "method", "whole", "nominal [mm]", "median [mm]", "worst [mm]", "overconfident")
    table = terminal.table_of("largest / mean error of wall and base", *heads)
    for group in grouped(rows):
        nominal, worst = group.nominal, group.worst
        table.add_row(
            group.job if group.sheet == "fast" else f"{group.job}, {group.sheet}",
            group.method,
            f"{len(group.whole)} of {len(group.rows)}",
            _pair(nominal.max_mm, nominal.mean_mm) if nominal else "-",
            _pair(group.median("max_mm"), group.median("mean_mm")) if group.others else "-",
            f"{_pair(worst.max_mm, worst.mean_mm)} ({worst.variant})" if worst else "-",
            f"{group.overconfident} of {len(group.told)}" if group.told else "-",
        )
    if rows:
        terminal.console.print(table)
    for row in rows:
        if row.overload:
            terminal.warn(f"{row.job}, {row.method}, variant {row.variant}: {row.overload}")


def _pair(largest: float | None, mean: float | None) -> str:
    return f"{largest or 0.0:.2f} / {mean or 0.0:.2f}"
