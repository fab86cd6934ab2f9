"""``isf describe``: the URDF of a rig, or of the cell of a job."""

from __future__ import annotations

import re
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.job import JobFile, load_job
from isf_core.files.rig import load_rig, tools_with_spindle_cells
from isf_core.files.yaml_file import find_named
from isf_description.cell import ball_radius, describe
from isf_description.ros2_control import ControlBlock, controllers
from isf_description.urdf import to_urdf

from isf_cell.commands import terminal

PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


RATE = 500.0
"""Hz, of controllers where no job tells."""


def describe_cell(name: str, prefix: str, output: Path | None, *, as_json: bool, ros2_control: bool = False) -> None:
    """Write the URDF of ``name``, a rig or a job, for ``ros2_control`` with its block and the file of the controllers.

    Raises IsfError of the file, FILE_FIELD, FILE_NOT_WRITABLE.
    """
    if prefix and ros2_control:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "the joints of controllers have the names of the machine's",
            where="--prefix",
            advice="leave it out; cells of several have a namespace each",
        )
    if prefix and not PREFIX.fullmatch(prefix):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"'{prefix}' is no beginning of a name",
            where="--prefix",
            advice="letters, digits and underscores, such as left_",
        )
    rig_file, job_file = _rig_and_job(name)
    rig = load_rig(str(rig_file)) if job_file is None else job_file.rig
    made = describe(rig, job_file).prefixed(prefix)
    path = output or Path(f"{rig.name if job_file is None else job_file.job.name}.urdf")
    block = ControlBlock.of(rig, made, ball_radius(job_file, 1)) if ros2_control else None
    files = {path: to_urdf(made, block)}
    if block is not None:
        rate = RATE if job_file is None else job_file.job.control.rate
        files[path.with_name(f"{path.stem}_controllers.yaml")] = controllers(block.tools, rate)
    for file, text in files.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        except OSError as error:
            raise IsfError(ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(file)) from error
    movable = [joint.name for joint in made.movable]
    if as_json:
        found = {
            "urdf": str(path),
            "controllers": str(list(files)[1]) if block is not None else None,
            "robot": made.name,
            "rig": str(rig_file),
            "spindle_cells": tools_with_spindle_cells(rig),
            # of a rig alone: by what it can, since parts with tilted tools may be asked for
            "tilts": job_file.tilts if job_file is not None else rig.largest_tilt > 0.0,
            "links": [link.name for link in made.links],
            "joints": movable,
        }
        terminal.print_json(found)
        return
    terminal.console.print(f"{made.name}: {len(made.links)} frames, {len(movable)} joints that move")
    terminal.console.print(f"[dim]{', '.join(movable)}[/dim]")
    for file in files:
        terminal.console.print(str(file))


def _rig_and_job(name: str) -> tuple[Path, JobFile | None]:
    """File of a rig, and the job if ``name`` is one: a file with the field ``rig``."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") and re.search(r"^rig:", yaml_file.read(path), re.MULTILINE):
        job_file = load_job(path)
        return find_named("rigs", job_file.job.rig, job_file.base).absolute(), job_file
    return find_named("rigs", name).absolute(), None
