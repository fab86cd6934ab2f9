"""What the ``isf`` command shows: text for people on stderr, results or one JSON object on stdout."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from isf_core.errors import ErrorCode, IsfError, coded
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from isf_cell.run.part_step import PartStep

console = Console(stderr=True, highlight=False)
"""Progress, tables and errors."""


def print_json(data: Mapping[str, Any]) -> None:
    """The one JSON object of ``--json``, on stdout; NaN and infinity become null."""
    print(json.dumps(without_nan(data), indent=2, allow_nan=False))


def error_data(error: IsfError) -> dict[str, Any]:
    """What ``--json`` tells of a failure, under the name ``error``."""
    return {"code": error.code.value, "name": error.code.name, "message": error.message}


def show_error(error: IsfError, *, as_json: bool = False) -> None:
    """One expected failure: sentence, place, advice and code."""
    if as_json:
        print_json({"error": error_data(error)})
    place = f"[bold]{escape(error.where)}[/bold]: " if error.where else ""
    console.print(f"[bold red]error[/bold red] {error.code.value} {error.code.name}", highlight=False)
    console.print(f"  {place}{escape(error.what)}", highlight=False, soft_wrap=True)
    if error.advice:
        console.print(f"  [dim]{escape(error.advice)}[/dim]", highlight=False, soft_wrap=True)


def say(text: str) -> None:
    """Text as it is: brackets in it are units, lists or paths, not markup."""
    console.print(text, soft_wrap=True, markup=False)


def warn(text: str) -> None:
    """One warning."""
    console.print("[yellow]warning[/yellow]", escape(text), soft_wrap=True)


def table_of(title: str, *columns: str) -> Table:
    """An empty table; title and heads are taken as they are ("[mm]" is a unit), columns but the first stand right."""
    table = Table(title=escape(title), title_justify="left")
    for number, name in enumerate(columns):
        table.add_column(escape(name), justify="right" if number else "left")
    return table


@contextmanager
def part_progress(title: str) -> Iterator[PartProgress]:
    """Progress of a part, contour by contour; a plain line per tenth of the part when there is no terminal."""
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[news]}"),
    )
    with Progress(*columns, console=console, transient=False, disable=not console.is_terminal) as progress:
        yield PartProgress(progress, title)


class PartProgress:
    """One progress bar that shows the numbers an operator looks at."""

    def __init__(self, progress: Progress, title: str) -> None:
        self._progress = progress
        self._task = progress.add_task(title, total=None, news="")
        self._last_tenth = -1
        self._last_phase = ""

    def phase(self, text: str) -> None:
        """What is being done before or between contours."""
        self._progress.update(self._task, news=f"[dim]{escape(text)}[/dim]")
        kind = "".join(c for c in text if not c.isdigit())  # "contour 3 of 42" is the same phase as "contour 2 of 42"
        if not console.is_terminal and kind != self._last_phase:
            say(f"  {text}")
        self._last_phase = kind

    def share(self, done: int, count: int) -> None:
        """So many contours are done."""
        self._progress.update(self._task, completed=done, total=count)

    def contour(self, step: PartStep) -> None:
        """One more contour is formed."""
        done, count = step.index + 1, step.count
        parts = [f"depth {1e3 * step.depth:5.1f} mm", f"Fz {step.forming_force:4.0f} N"]
        if not math.isnan(step.support_force):
            parts.append(f"support {step.support_force:4.0f} N")
        if not math.isnan(step.correction):
            parts.append(f"correction {1e3 * step.correction:4.2f} mm")
        news = "  ".join(parts)
        self._progress.update(self._task, completed=done, total=count, news=news)
        tenth = 10 * done // max(count, 1)
        if not console.is_terminal and tenth != self._last_tenth:
            self._last_tenth = tenth
            console.print(f"  contour {done}/{count}  {news}")


def show_summary(summary: Mapping[str, Any], reference: Mapping[str, Any] | None) -> None:
    """The numbers of a part as a table, beside those of the uncorrected reference when there is one."""
    from isf_analysis.measures.percent import percent

    title = f"{summary.get('job', 'part')}: {summary.get('contours', 0)} contours"
    own = str(summary.get("correction", "result"))
    table = table_of(title, "", "uncorrected", own) if reference else table_of(title, "", own)

    def row(label: str, value: str, other: str = "") -> None:
        table.add_row(escape(label), *([other] if reference else []), value)

    def found(source: Mapping[str, Any] | None, path: Sequence[str]) -> Any:
        value: Any = source
        for key in path:
            value = value.get(key) if isinstance(value, Mapping) else None
        return value

    def number(source: Mapping[str, Any] | None, *path: str, digits: int = 2) -> str:
        value = found(source, path)
        return "-" if value is None else f"{value:.{digits}f}"

    def share(source: Mapping[str, Any] | None, *path: str, digits: int = 1) -> str:
        value = found(source, path)
        return "-" if value is None else percent(value, digits)

    for key, label in (("max_mm", "max error"), ("mean_abs_mm", "mean error"), ("rms_mm", "rms error")):
        row(
            f"{label}, wall and base [mm]",
            number(summary, "deviation", key),
            number(reference, "deviation", key),
        )
    if expected := summary.get("expected_error"):
        row("expected largest / mean error [mm]", _expected(expected))
    whole = ("deviation", "regions", "wall_and_base")
    within, seen = (*whole, "within_tolerance_fraction"), (*whole, "coverage")
    row(
        f"points in tolerance ({number(summary, 'tolerance', 'shape_mm')} mm), wall and base",
        share(summary, *within),
        share(reference, *within),
    )
    if any(share(source, *seen) not in ("-", "100 %") for source in (summary, reference)):
        row("measured share of wall and base", share(summary, *seen), share(reference, *seen))
    force = summary.get("force") or {}
    if force.get("set_N"):
        usual, low, high = (number(summary, "force", key, digits=0) for key in ("set_N", "set_min_N", "set_max_N"))
        one = low == high or "-" in (low, high)
        row("support force set-point [N]", usual if one else f"{low} to {high}, by place", "")
        row("time in full control within 10 N", share(force, "within_10N_fraction", digits=2))
        row("force error, 99.9 % of the time below [N]", number(summary, "force", "p999_abs_error_N", digits=1))
    if sheet := summary.get("sheet"):
        words = {
            "fast": "fast: yields under the tools alone",
            "shell": "elasto-plastic shell",
            "shell_coarse": "elasto-plastic shell, coarse",
            "shell_fine": "elasto-plastic shell, fine",
        }
        row("simulated sheet", words.get(sheet["model"], sheet["model"]))
    row("late ticks / lost messages", f"{summary.get('late_ticks', 0)} / {summary.get('lost_messages', 0)}")
    row("process time / wall time [s]", f"{number(summary, 'sim_s', digits=1)} / {number(summary, 'wall_s', digits=1)}")
    console.print(table)
    _show_verdict(summary)
    for warning in _warnings(summary):
        warn(warning)


def _expected(found: Mapping[str, Any]) -> str:
    """What the correction expected of wall and base, and how far beyond or below it the part came out."""
    if found["largest_mm"] is None:
        return "not known"
    ratio = found["reached_over_expected"]
    pair = f"{found['largest_mm']:.2f} / {found['mean_mm']:.2f}"
    return pair if ratio is None else f"{pair} (reached: {ratio:.1f} x)"


def _show_verdict(summary: Mapping[str, Any]) -> None:
    """Green for a good part alone; else what it falls short of, or the proviso under which it is good."""
    found = summary.get("verdict")
    if found is None:
        return
    if found["good"]:
        if proviso := found["proviso"]:
            console.print("[bold cyan]part complete, in tolerance on the fast sheet[/bold cyan]")
            say(f"  {proviso}")
        else:
            console.print("[bold green]part complete and good[/bold green]")
        return
    head = "[bold yellow]part complete, but not good[/bold yellow]"
    console.print(head if summary.get("complete") else "[bold red]part or record not complete[/bold red]")
    for text in found["short_of"]:
        say(f"  {text}")


def _warnings(summary: Mapping[str, Any]) -> list[str]:
    """What the numbers of a part lack, and that a method that looks at the part saw nothing of it."""
    remarks = [str(remark["text"]) for remark in summary.get("remarks") or ()]
    if remarks:
        from isf_springback.estimators.fused import MODEL_ALONE  # late: takes a second to load

        remarks = [text for text in remarks if text == MODEL_ALONE]
    expected = summary.get("expected_error") or {}
    if expected.get("overconfident"):
        ratio = expected["reached_over_expected"]
        remarks.append(f"the largest error is {ratio:.1f} times what the correction expected: it was overconfident")
    return [*map(str, summary.get("notes") or ()), *remarks]


def unexpected(error: Exception) -> IsfError:
    """An unforeseen failure in the same form as the expected ones; NODE_MISSING where ROS is not installed."""
    missing = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if missing == "rclpy" or missing.endswith(("_msgs", "_srvs", "_interfaces")):
        return IsfError(
            ErrorCode.NODE_MISSING,
            f"this command needs ROS 2 and the built workspace: there is no {missing}",
            advice="source ros_ws/install/setup.bash; plan, simulate, report, replay, compare and bag need no ROS",
        )
    return coded(error, advice="a fault of this software; ISF_TRACEBACK=1 shows more")


def without_nan(value: Any) -> Any:
    """``value`` with NaN and infinities replaced by None, at any depth."""
    if isinstance(value, Mapping):
        return {str(key): without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
