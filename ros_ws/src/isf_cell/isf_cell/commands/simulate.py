"""``isf simulate``: a part in this process, with report; Ctrl-C stops it after the present contour."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType

from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.measures.record import PartRecord
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import torn
from isf_core.files.job import JobFile, load_job
from isf_springback.methods import check_method

from isf_cell import in_process
from isf_cell.commands import terminal
from isf_cell.commands.elastic_database import prepare_database
from isf_cell.commands.report import finish, first_failure
from isf_cell.commands.run_folder import run_folder
from isf_cell.options import UNCORRECTED, RunOptions
from isf_cell.processes.ctrl_c import ctrl_c_handled_by, interrupt
from isf_cell.processes.reference_run import ReferenceRun
from isf_cell.run.part_step import PartStep


def simulate_part(job: Path, options: RunOptions, output: Path | None, *, compare: bool, as_json: bool) -> None:
    """Form ``job`` in process; raises IsfError when the part does not complete or tears.

    Ctrl-C ends the part after the present contour; what was formed is kept and reported, with CANCELLED.
    """
    job_file = load_job(job)
    options.check(job_file)
    check_method(options.method(job_file), job_file, options.named_at)
    with run_folder(output, job_file.job.name) as folder:
        bag = folder / "bag"
        run: ReferenceRun | None = None
        reference: Path | None = None
        try:
            with ExitStack() as stack:
                if compare and options.method(job_file) != UNCORRECTED:
                    run = stack.enter_context(ReferenceRun(job, options, folder / "uncorrected"))
                title = f"{job_file.job.name} ({options.method(job_file)}, in process)"
                progress = stack.enter_context(terminal.part_progress(title))
                prepare_database(job_file, options.method(job_file), progress.phase)
                record = _form(job_file, options, progress)
                write_bag(record, bag)
                counts = {"sheet": dict(record.sheet)}
                failure = torn(record.events) or first_failure(record.results) or stopped(record)
                if run is not None and not (failure and failure.code == ErrorCode.CANCELLED):
                    progress.phase("waiting for the uncorrected part")
                    reference = run.bag_at_end(terminal.warn)
            finish(folder, reference, failure=failure, as_json=as_json, counts=counts)
        except KeyboardInterrupt:
            raise _stopped_at_once(bag) from None


def _form(job_file: JobFile, options: RunOptions, progress: terminal.PartProgress) -> PartRecord:
    with ctrl_c_stops_between_contours() as request:

        def formed(step: PartStep) -> None:
            request.contour_formed()
            progress.contour(step)

        progress.phase("planning")
        return in_process.form(
            job_file, options, progress=formed, cancelled=lambda: request.wanted, warned=terminal.warn
        )


def stopped(record: PartRecord) -> IsfError | None:
    """CANCELLED when ``record`` ends before its last contour, else None."""
    count = record.nominal[-1].count if record.nominal else 0
    if len(record.results) == count:
        return None
    return IsfError(
        ErrorCode.CANCELLED,
        f"stopped by the operator after contour {len(record.results)} of {count}",
        advice="the contours formed are kept and reported",
    )


def _stopped_at_once(bag: Path) -> IsfError:
    if (bag / "metadata.yaml").exists():
        return IsfError(
            ErrorCode.CANCELLED,
            "stopped by the operator; the part is kept",
            where=str(bag),
            advice=f"isf report {bag} makes its report",
        )
    return IsfError(
        ErrorCode.CANCELLED,
        "stopped by the operator; nothing of the part is kept",
        advice="Ctrl-C once, after the first contour, keeps and reports what was formed",
    )


class StopRequest:
    """Before the first contour, and asked twice, it stops at once: there is nothing, or no time, to keep."""

    def __init__(self) -> None:
        self.contours = 0
        self.wanted = False

    def contour_formed(self) -> None:
        """From now on there is something to keep."""
        self.contours += 1

    def ask(self, number: int, frame: FrameType | None) -> None:
        """Handler of the signal; raises KeyboardInterrupt to stop at once."""
        if self.wanted or not self.contours:
            interrupt(number, frame)
            return
        self.wanted = True
        terminal.console.print("  stopping after this contour; Ctrl-C again stops at once and keeps nothing")


@contextmanager
def ctrl_c_stops_between_contours() -> Iterator[StopRequest]:
    """Ctrl-C goes to the request given; where it is handled otherwise, or ignored, nothing changes."""
    request = StopRequest()
    with ctrl_c_handled_by(request.ask):
        yield request
