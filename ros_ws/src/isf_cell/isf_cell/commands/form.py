"""``isf form``: a part through the node graph, with report; or the rest of one."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import Any

from isf_core.contour import contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.simulated_sheet import check_clock, check_sheet
from isf_msgs.action import FormPart

from isf_cell.commands import resume, terminal
from isf_cell.commands.dashboard import address_beside
from isf_cell.commands.elastic_database import prepare_database
from isf_cell.commands.run_folder import make_folder, run_folder
from isf_cell.options import UNCORRECTED, RunOptions
from isf_cell.processes.reference_run import ReferenceRun
from isf_cell.run import graph_run
from isf_cell.run.cell import PLAN_WARNING
from isf_cell.run.part_keeper import NOT_KEPT
from isf_cell.run.part_step import PartStep


def form_part(
    job: Path,
    options: RunOptions,
    output: Path | None,
    *,
    compare: bool,
    lockstep: bool,
    dashboard: bool = False,
    attach: bool = False,
    as_json: bool,
) -> None:
    """Form ``job`` with a cell of its own, or ``attach`` to the one that is up; raises IsfError when the part does not
    complete."""
    job_file = load_job(job)
    options.check(job_file)
    if not attach:  # nothing is started for a part that cannot be formed
        check_sheet(options.sheet_of(job_file), job_file.job)
        if not lockstep:
            check_clock(options.sheet_of(job_file), job_file.job, where="--real-time")
    with run_folder(output, job_file.job.name) as folder:
        if attach:
            with resume.alone(folder):
                resume.Request(job, attach=True).write(folder)
                _form(job_file, options, folder, job if compare else None, None, attach=True, as_json=as_json)
            return
        form_in(
            folder, job, job_file, options, compare=compare, lockstep=lockstep, dashboard=dashboard, as_json=as_json
        )


def form_in(
    folder: Path,
    job: Path,
    job_file: JobFile,
    options: RunOptions,
    *,
    compare: bool,
    lockstep: bool,
    dashboard: bool,
    as_json: bool,
    told: Mapping[str, Any] | None = None,
) -> None:
    """Form ``job``, read as ``job_file``, with its results in ``folder``; ``told``: goes into the JSON object, too.

    Raises IsfError as :func:`form_part`.
    """
    with resume.alone(folder):
        resume.Request(job).write(folder)
        port = address_beside()[0] if dashboard else None
        shown = job if compare else None
        _form(job_file, options, folder, shown, port, lockstep=lockstep, as_json=as_json, told=told or {})


def resume_part(
    run: Path,
    given: Mapping[str, Any],
    *,
    compare: bool,
    dashboard: bool = False,
    attach: bool = False,
    as_json: bool,
) -> None:
    """Form the rest of the part in the folder ``run``, with a cell of its own, or ``attach`` to the one that is up.

    ``given``: options of the command line by their names.

    Raises IsfError as :func:`isf_cell.commands.resume.resumed`, BUSY, and when the part does not complete.
    """
    if not run.is_dir():
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such run", where=str(run), advice="check the path")
    folder = make_folder(run)
    resume.Request.read(folder)  # before anything is written into a folder that is no run
    with resume.alone(folder):
        found = resume.resumed(folder, given)
        checkpoint = found.checkpoint
        job = found.job if compare else None
        if compare and job is None and checkpoint.correction != UNCORRECTED:
            terminal.say("the job file is gone or another one by now: the uncorrected part is left out")
        job_file, options = checkpoint.job_file, checkpoint.options
        port = address_beside()[0] if dashboard else None
        lockstep = checkpoint.lockstep
        _form(job_file, options, folder, job, port, lockstep=lockstep, as_json=as_json, goes_on=True, attach=attach)


def _form(
    job_file: JobFile,
    options: RunOptions,
    folder: Path,
    compared: Path | None,
    port: int | None,
    *,
    lockstep: bool = True,
    as_json: bool,
    goes_on: bool = False,
    attach: bool = False,
    told: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """``compared``: job file of the uncorrected part that is simulated, None: none; ``port`` of a page, None: none."""
    method = options.method(job_file)
    mode = "the cell that is up" if attach else "lockstep" if lockstep else "real time"
    with ExitStack() as stack:
        progress = stack.enter_context(terminal.part_progress(f"{job_file.job.name} ({method}, ROS 2, {mode})"))
        prepare_database(job_file, method, progress.phase)
        progress.phase("looking for the cell" if attach else "starting the nodes")

        def show(message: FormPart.Feedback) -> None:
            if message.phase == "paused":
                progress.phase(f"waits after {contour_label(message.index - 1)}; in another terminal: isf go-on")
                return
            if message.phase.startswith((NOT_KEPT, PLAN_WARNING)):
                terminal.warn(message.phase.removeprefix(PLAN_WARNING))
                return
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

        try:
            if attach:
                result, failure = graph_run.form_attached(job_file, options, folder, show, resume=goes_on)
            else:
                result, failure = graph_run.form(
                    job_file, options, folder, show, lockstep=lockstep, resume=goes_on, dashboard_port=port
                )
        except IsfError as error:
            raise resume.with_advice(error, folder) from error
        if failure is not None:
            failure = resume.with_advice(failure, folder)
        reference: Path | None = None
        if compared is not None and method != UNCORRECTED and failure is None:
            progress.phase("simulating the uncorrected part")
            run = stack.enter_context(ReferenceRun(compared, options, folder / "uncorrected"))
            reference = run.bag_at_end(terminal.warn)
    from isf_cell.commands.report import finish  # late: figures take a second to load, the nodes should start first

    counts = {
        "contours": result.contours,
        "ticks": result.ticks,
        "late_ticks": result.late_ticks,
        "lost_messages": result.lost_messages,
        "sim_s": result.sim_time,
        "wall_s": result.wall_time,
    }
    if not result.wall_time:  # of an executive that is gone: the bag knows them
        counts = {}
    counts = {**told, **counts}
    finish(folder, reference, failure=failure, as_json=as_json, counts=counts)
