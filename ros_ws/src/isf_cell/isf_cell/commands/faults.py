"""``isf faults``: disturbs real cells in every way that is known, and shows what came of it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence, Set
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError

from isf_cell.commands import terminal
from isf_cell.commands.exit_codes import Exit, ReportedError
from isf_cell.commands.run_folder import make_folder, make_run_folder
from isf_cell.faults import campaign
from isf_cell.faults.campaign import Case, Plan
from isf_cell.faults.rows import HEAD, Row, cells_of, page_of, rows_of

PAGE = "faults.md"
SHOWN = {
    "kind": "kind",
    "injected": "n",
    "held, p99 [ms]": "held ms",
    "released, max [s]": "free s",
    "diagnosed": "diagnosed",
    "resumed": "resumed",
    "misses": "misses",
}
"""Columns of the table in the terminal, of those of the page."""

RESUMED_IN_SHORT = ("kill force_ctrl",)
"""A part is gone on with after these alone: to form the rest of it takes as long as to disturb the next one."""


def run_faults(
    output: Path | None, kinds: Sequence[str], *, short: bool, faults: int, seed: int, resume: bool, as_json: bool
) -> None:
    """Run the campaign, or the rest of the one in ``output``; exits with CHECK_FAILED when a kind misses a goal, or
    faults are missing.

    Raises IsfError FILE_FIELD (unknown kind), FILE_NOT_WRITABLE, of cells that do not come up; Ctrl-C keeps what was
    judged.
    """
    wanted = campaign.chosen(kinds, short=short)
    goes_on = output is not None and (output / campaign.CASES_FILE).exists()
    folder = make_folder(output) if goes_on and output is not None else make_run_folder(output, "faults")
    (folder / campaign.CASES_FILE).touch()  # ended before the first case, it goes on as well
    resumed = frozenset(RESUMED_IN_SHORT if short else ())
    plan = Plan(folder, wanted, 1 if short else faults, seed, None if resume and not short else resumed)
    planned = {(kind.name, number) for kind in wanted for number in range(plan.faults)}
    total = len(planned)
    cases = [case for case in campaign.read_cases(folder) if case.seed == seed]
    terminal.say(f"{total} faults of {len(wanted)} kinds, {_done(cases, planned)} of them done, in {folder}")
    failure: IsfError | None = None
    page = folder / PAGE
    try:
        for case in campaign.run(plan, lambda text: terminal.say(f"  {text}")):
            cases.append(case)
            terminal.say(f"  {_done(cases, planned)}/{total} {_line(case)}")
    except KeyboardInterrupt:
        failure = IsfError(ErrorCode.CANCELLED, "stopped by the operator", where=str(folder))
    except IsfError as error:
        failure = error
    finally:
        rows = rows_of(cases)
        if rows:
            load, cores = os.getloadavg()[1], os.cpu_count() or 1
            page.write_text(page_of(rows, seed=seed, load=load, cores=cores), encoding="utf-8")
            _show(rows)
            terminal.say(f"page    {page}")
    if failure is not None and not rows:
        raise failure
    good = failure is None and _done(cases, planned) == total and not any(row.misses for row in rows)
    if as_json:
        data = {"ok": good, "faults": len(cases), "planned": total, "seed": seed, "page": str(page) if rows else None}
        told = {} if failure is None else {"error": terminal.error_data(failure)}
        terminal.print_json({**data, "rows": [row.as_dict() for row in rows], **told})
    if failure is not None:
        raise ReportedError(failure)
    if not good:
        sys.exit(Exit.CHECK_FAILED)


def _done(cases: Sequence[Case], planned: Set[tuple[str, int]]) -> int:
    """How many of the faults that are ``planned``, by kind and number, are among the ``cases``."""
    return len(planned & {(case.kind, case.number) for case in cases})


def _line(case: Case) -> str:
    """What came of one fault, in a line."""
    end = "went on" if case.went_on else f"ended with {case.code}"
    parts = [f"{case.kind} in contour {case.contour + 1}: {end}"]
    if case.reaction is not None:
        parts.append(f"held after {1e3 * case.reaction:.0f} ms")
    if case.released is not None:
        parts.append(f"released after {case.released:.2f} s")
    if case.resumed is not None:
        parts.append("resumed" if case.resumed else "not resumed")
    return ", ".join(parts) + ("" if case.good else "  (misses a goal)")


def _show(rows: Sequence[Row]) -> None:
    """The goals alone; the page has all of it."""
    table = terminal.table_of("fault campaign", *SHOWN.values())
    for row in rows:
        cells = dict(zip(HEAD, cells_of(row), strict=True))
        table.add_row(*(cells[name] for name in SHOWN))
    terminal.console.print(table)
