"""``isf form``: a part through the node graph, with report."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from isf_core.files.job import load_job
from isf_msgs.action import FormPart

from isf_cell.commands import terminal
from isf_cell.commands.run_folder import run_folder
from isf_cell.options import UNCORRECTED, RunOptions
from isf_cell.processes.reference_run import ReferenceRun
from isf_cell.run import graph_run
from isf_cell.run.part_step import PartStep


def form_part(
    job: Path, options: RunOptions, output: Path | None, *, compare: bool, lockstep: bool, as_json: bool
) -> None:
    """Form ``job`` with a cell of its own; raises IsfError when the part does not complete."""
    job_file = load_job(job)
    options.check(job_file)
    method = options.method(job_file)
    mode = "lockstep" if lockstep else "real time"
    with ExitStack() as stack:
        folder = stack.enter_context(run_folder(output, job_file.job.name))
        progress = stack.enter_context(terminal.part_progress(f"{job_file.job.name} ({method}, ROS 2, {mode})"))
        progress.phase("starting the nodes")

        def show(message: FormPart.Feedback) -> None:
            if message.phase != "forming":
                progress.phase(message.phase)
                return
            progress.contour(
                PartStep(
                    message.index,
                    message.count,
                    depth=message.depth,
                    forming_force=message.forming_force,
                    support_force=message.support_force,
                    correction=message.correction,
                )
            )

        result, failure = graph_run.form(job_file, options, folder, show, lockstep=lockstep)
        reference = None
        if compare and method != UNCORRECTED and failure is None:
            progress.phase("simulating the uncorrected part")
            reference = stack.enter_context(ReferenceRun(job, options, folder / "uncorrected"))
            reference.wait()
    from isf_cell.commands.report import finish  # late: figures take a second to load, the nodes should start first

    counts = {
        "contours": result.contours,
        "ticks": result.ticks,
        "late_ticks": result.late_ticks,
        "lost_messages": result.lost_messages,
        "sim_s": result.sim_time,
        "wall_s": result.wall_time,
    }
    finish(folder, reference.bag if reference else None, failure=failure, as_json=as_json, counts=counts)
