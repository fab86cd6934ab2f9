"""``isf cell``: a cell that stays up until Ctrl-C: for parts, movement by hand and the page."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_core.files.rig import load_rig, tools_with_spindle_cells
from isf_core.files.yaml_file import find_named

from isf_cell.commands import terminal
from isf_cell.commands.dashboard import address_beside
from isf_cell.commands.run_folder import run_folder
from isf_cell.processes.cell_nodes import CellChoice
from isf_cell.processes.domain_lock import alone_in_domain
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run.graph_run import CellClient, start_nodes, text_log_beside

END_PATIENCE = 1.5
"""s that a node has for its end; what is left of 5 s after a part that is cancelled and a machine that is stopped."""

HOW_TO_GO_ON = (
    ("isf form {job} --attach", "form a part in it"),
    ("isf mode manual{mode}", "move tools by hand, then isf move-to, isf jog, isf zero"),
    ("isf dashboard", "its page in the browser"),
)


def choice_of(job: Path | None, rig: str | None) -> CellChoice:
    """The cell of a job, or of a rig (name or file), or of neither; raises IsfError of the files."""
    if job is not None and rig is not None:
        raise IsfError(
            ErrorCode.FILE_FIELD, "a job names its own rig", where="--rig", advice="leave out --rig, or the job"
        )
    choice = CellChoice(viewers=True)
    if job is not None:
        job_file = load_job(job)
        path = str(find_named("rigs", job_file.job.rig, job_file.base))
        cells = tools_with_spindle_cells(job_file.rig)
        turns = job_file.rig.largest_tilt > 0.0  # whatever this job does: others are formed in this cell, too
        return replace(choice, job=str(job.resolve()), rig=path, load_cells=cells, tilts=turns)
    if rig is not None:
        path = str(find_named("rigs", rig, Path.cwd()))
        machine = load_rig(rig, Path.cwd())
        cells = tools_with_spindle_cells(machine)
        return replace(choice, rig=path, load_cells=cells, tilts=machine.largest_tilt > 0.0)
    return choice


def stand(
    job: Path | None,
    rig: str | None,
    output: Path | None,
    runs: Path,
    *,
    lockstep: bool,
    machine: bool,
    page: bool,
    record: bool,
    as_json: bool,
) -> None:
    """Start the nodes, tell how to go on, and stay until Ctrl-C; then lift the tools and end all of them.

    Parts that are formed in it are kept below the folder ``runs``.

    Raises
    ------
    IsfError : of files; BUSY for a second cell in the ROS domain; NODE_MISSING; NODE_DIED when a node ends
    """
    choice = replace(choice_of(job, rig), lockstep=lockstep and machine, machine=machine, runs=str(runs.resolve()))
    signal.signal(signal.SIGTERM, lambda *_: os.kill(os.getpid(), signal.SIGINT))  # a service manager ends it so
    with run_folder(output, "cell") as folder, alone_in_domain(), ExitStack() as stack:
        if record:
            choice = replace(choice, bag=str(folder / "bag"), text_log=str(text_log_beside(folder / "bag")))
        client = CellClient()
        stack.callback(client.close)
        group = ProcessGroup(folder / "logs")
        stack.callback(group.stop, END_PATIENCE)
        with terminal.console.status("starting the nodes"):
            url = ""
            if page:
                port, url = address_beside()
                group.start("isf_dashboard", "dashboard", {"port": port}, outlives=True)
            start_nodes(group, choice)
            client.wait_ready(group)
        _tell(group, choice, job, url, as_json=as_json)
        try:
            with suppress(KeyboardInterrupt):
                client.stay(group)
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # once is enough: the tools are being lifted
            terminal.say("ending: tools are lifted")
            client.end_cell()


def _tell(group: ProcessGroup, choice: CellChoice, job: Path | None, url: str, *, as_json: bool) -> None:
    names = [node.name for node in group.nodes]
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if as_json:
        nodes = {node.name: node.popen.pid for node in group.nodes}
        terminal.print_json({"nodes": nodes, "domain": int(domain), "logs": str(group.log_folder), "page": url})
        sys.stdout.flush()  # whoever waits for it goes on while the cell stays
    how = "in lockstep" if choice.lockstep else "by the clock"
    terminal.say(f"the cell is up in ROS domain {domain}, {how}: {', '.join(names)}")
    terminal.say(f"logs    {group.log_folder}")
    if choice.bag:
        terminal.say(f"bag     {choice.bag}")
    shown = {command.format(job=job or "JOB", mode="" if job else " JOB"): what for command, what in HOW_TO_GO_ON}
    for command, what in shown.items():
        terminal.say(f"  {command:<{max(map(len, shown))}}   {what}")
    terminal.say("Ctrl-C ends it")
