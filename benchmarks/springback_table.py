"""The table of springback: published parts, methods and worlds; goes on where it was stopped.

    ./isf python benchmarks/springback_table.py                                  # nominal world, every part
    ./isf python benchmarks/springback_table.py --worlds 0,1-20 --jobs 2 --page  # everything (hours), then the page
    ./isf python benchmarks/springback_table.py --parts ren_cone --methods none "fused(analytic)" --worlds 1-3
    ./isf python benchmarks/springback_table.py --sheet shell_coarse --parts ren_cone --methods none elastic
    ./isf python benchmarks/springback_table.py --only-page --any-version        # page of the rows there are

Rows are kept as JSON lines in ``--rows``, named by the content of job, world, method and package sources: a row that is
there is not computed again. World 0 is nominal, 1 to 20 are the standard off-nominal worlds.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

import springback_page
import springback_rows
from isf_cell.campaign.content import sources
from isf_cell.campaign.rows_file import append_row, read_rows
from isf_cell.processes.process_group import ends_with_owner
from isf_core.errors import IsfError
from isf_core.simulated_sheet import SheetKind
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from springback import PUSHED, Case, job_of, prepare
from springback_page import PARTS

ROOT = Path(__file__).resolve().parents[1]
ROWS = ROOT / "runs" / "springback_table" / "rows.jsonl"

Todo = list[tuple[Case, str]]


def cases_of(
    parts: Sequence[str] | None, methods: Sequence[str] | None, worlds: Sequence[int], sheet: str = "fast"
) -> list[Case]:
    """Cases in the order of their use: world after world, so that a campaign that is stopped holds whole worlds.

    Without ``parts`` all of them, large ones in the nominal world only. Without ``methods`` those of each part, but
    none with a push where ``sheet`` is not the fast one, which alone is pushed (:mod:`isf_cell.run.flat_push`).
    """
    return [
        Case(part, method, world, sheet)
        for world in worlds
        for part in parts or PARTS
        if parts or world == 0 or not PARTS[part].large
        for method in methods or PARTS[part].methods
        if methods or sheet == "fast" or not method.endswith(PUSHED)
    ]


def missing(cases: Sequence[Case], rows: dict[str, dict[str, Any]], digest: str) -> Todo:
    """Cases without a row, each with the name its row will have."""
    named = [(case, springback_rows.key(case, job_of(case)[0], digest)) for case in cases]
    return [(case, name) for case, name in named if name not in rows]


def _stay_with(parent: int) -> None:
    """A worker ends when its parent was killed."""
    ends_with_owner(signal.SIGKILL, parent)()


def compute(todo: Todo, digest: str, path: Path, processes: int, console: Console) -> None:
    """Compute the rows of ``todo`` in processes of their own and keep each as it comes."""
    maps = path.parent / "maps"
    # forked: all processes run the sources that were read at the start, whatever changes meanwhile
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_stay_with, initargs=(os.getpid(),))
    with _bar(console, len(todo)) as advance, pool:
        waiting: dict[Future[dict[str, Any]], Case] = {
            pool.submit(springback_rows.run, case, name, digest, maps): case for case, name in todo
        }
        try:
            for done in as_completed(waiting):
                row = done.result()
                append_row(path, row)
                advance(_reported(row))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _reported(row: dict[str, Any]) -> str:
    what = f"{row['job']}, {row['method']}, world {row['world']}"
    if row["code"]:
        return f"{what}: ended at contour {row['contours']} of {row['planned']}, {row['code']}"
    error = row.get("wall_and_base")
    if not error:
        return f"{what}: no scan"
    expected = row["expected"]
    told = f"{expected['max']:.2f} / {expected['mean']:.2f} mm" if expected else "not known"
    return f"{what}: {error['max']:.2f} / {error['mean']:.2f} mm, expected {told}, {row['cpu_s']:.0f} s"


@contextmanager
def _bar(console: Console, total: int) -> Iterator[Any]:
    """Progress of ``total`` runs; every finished one is a line, also where there is no terminal."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("runs", total=total)

        def advance(text: str) -> None:
            progress.advance(task)
            console.print(text, highlight=False)

        yield advance


def databases(todo: Todo, console: Console) -> None:
    """Databases of the shell, once per part, so that no run computes its own."""
    for part in dict.fromkeys(case.job for case, _ in todo if "elastic" in case.method):
        console.print(f"{part}: database of the elastic shell", highlight=False)
        prepare(part)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute what is missing, print the table, write the page when asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=sorted(PARTS), help="left out: all, large ones in world 0 only")
    parser.add_argument("--methods", nargs="+", help="for example: none analytic 'fused(elastic)'; None: of each part")
    parser.add_argument("--worlds", nargs="+", default=["0"], help="for example: 0,1-20")
    parser.add_argument("--sheet", choices=get_args(SheetKind), default="fast", help="model of the sheet")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--rows", type=Path, default=ROWS, help="file of the rows")
    parser.add_argument("--page", action="store_true", help="write docs/results/springback(_shell).md, pictures, rows")
    parser.add_argument("--only-page", action="store_true", help="compute nothing")
    parser.add_argument("--any-version", action="store_true", help="show rows of other sources too; the page says so")
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "results", help="where the page goes")
    options = parser.parse_args(arguments)
    console = Console()
    try:
        worlds = springback_rows.worlds(options.worlds)
    except ValueError:
        parser.error(f"--worlds {' '.join(options.worlds)}: numbers and ranges such as 0,1-20")
    digest = sources()
    cases = cases_of(options.parts, options.methods, worlds, options.sheet)
    if options.sheet != "fast" and any(case.method.endswith(PUSHED) for case in cases):
        parser.error(
            f"--sheet {options.sheet}: the flat sheet is pushed on the fast one alone; name --methods without {PUSHED}"
        )
    rows = read_rows(options.rows)
    try:
        todo = missing(cases, rows, digest)
        console.print(f"{len(cases) - len(todo)} of {len(cases)} runs are there; sources {digest}", highlight=False)
        if todo and not options.only_page:
            databases(todo, console)
            compute(todo, digest, options.rows, options.jobs, console)
            rows = read_rows(options.rows)
    except IsfError as error:
        console.print(str(error), highlight=False)
        return 1
    except KeyboardInterrupt:
        console.print("stopped; the same command goes on from here")
        return 130
    shown = springback_rows.latest([row for row in rows.values() if options.any_version or row["sources"] == digest])
    fast = options.sheet == "fast"
    shown = [row for row in shown if (springback_rows.sheet_of(row) == "fast") == fast]
    print(springback_page.table(shown) if fast else springback_page.shell_table(shown))
    told = [row for row in shown if springback_rows.ratio(row) is not None]
    over = sum(springback_rows.is_overconfident(row) for row in told)
    print(f"\n{over} of {len(told)} whole parts that expected an error came out worse than 1.5 times that")
    if options.page or options.only_page:
        maps = options.rows.parent / "maps"
        if fast:
            page = springback_page.write(shown, digest, maps, options.folder)
        else:
            page = springback_page.write_shell(shown, maps, options.folder)
        console.print(f"written: {page}", highlight=False)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
