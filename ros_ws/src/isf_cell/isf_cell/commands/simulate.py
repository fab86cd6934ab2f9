"""``isf simulate``: a part in this process, with report."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from isf_analysis.bag_writer import write_bag
from isf_core.job import load_job

from isf_cell import in_process, terminal
from isf_cell.commands.finish import finish, first_failure
from isf_cell.options import RunOptions
from isf_cell.reference_run import UNCORRECTED, ReferenceRun
from isf_cell.run_folder import make_run_folder


def simulate_part(job: Path, options: RunOptions, output: Path | None, *, compare: bool, as_json: bool) -> None:
    """Form ``job`` in process; raises IsfError when the part does not complete."""
    job_file = load_job(job)
    method = options.method(job_file)
    folder = make_run_folder(output, job_file.job.name)
    with ExitStack() as stack:
        reference = None
        if compare and method != UNCORRECTED:
            reference = stack.enter_context(ReferenceRun(job, options, folder / "uncorrected"))
        progress = stack.enter_context(terminal.part_progress(f"{job_file.job.name} ({method}, in process)"))
        progress.phase("planning")
        record = in_process.form(job_file, options, progress=progress.contour)
        write_bag(record, folder / "bag")
        if reference:
            progress.phase("waiting for the uncorrected part")
            reference.wait()
    finish(folder, reference.bag if reference else None, failure=first_failure(record.results), as_json=as_json)
