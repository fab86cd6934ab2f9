"""Identification on the simulated machine in one process: form a wall, then measure with the tools in the cell.

Counterpart of :func:`isf_cell.run.identify_client.identify_in_cell`, which asks a running cell.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import date

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_identify.identification import Finding, check_job, finding, make_probe
from isf_identify.rig_piece import rig_reference
from isf_identify.settings import IdentifySettings, Property, ToolGeometry
from isf_sim.machine.simulated_machine import SimulatedMachine

from isf_cell.options import UNCORRECTED, RunOptions
from isf_cell.run.cell import PartGoal
from isf_cell.run.in_process_cell import InProcessCell

WALL = 0.7
"""Share of the contours that are formed first, unless the caller says otherwise."""

Progress = Callable[[str, float], None]


def identify(
    job_file: JobFile,
    settings: IdentifySettings,
    *,
    contours: int | None = None,
    variant: int = 0,
    seed: int = 0,
    progress: Progress | None = None,
    machine: SimulatedMachine | None = None,
) -> Finding:
    """What the tools find out about the simulated ``machine`` (None: one of ``variant`` and ``seed``).

    ``contours`` are formed first (None: most of the part; none for the servo). Raises IsfError as planning, forming and
    the measurement do.
    """
    notify = progress or (lambda phase, share: None)
    geometry = ToolGeometry.from_job(job_file)
    check_job(settings, geometry)  # before a wall is formed for it
    cell = InProcessCell(machine=machine)
    goal = PartGoal(job_file, RunOptions(correction=UNCORRECTED, variant=variant, seed=seed))
    cell.reset(goal)
    cell.tare()
    planned = cell.plan(goal)
    cell.arm(goal, planned)
    wanted = _contours(settings, planned.count) if contours is None else contours
    if not 0 <= wanted < planned.count:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"{wanted} contours cannot be formed before the identification",
            where="contours",
            advice=f"0 to {planned.count - 1}",
        )
    for index in range(wanted):
        notify("forming a wall", index / wanted)
        result = cell.form_contour(index).result
        if not result.completed:
            raise IsfError(ErrorCode(result.code), result.message)
    probe = cell.measure(
        lambda rest: make_probe(rest, settings, geometry), lambda measured: notify(measured.phase, measured.progress)
    )
    return finding(probe, cell.config, job_file.rig, rig_reference(job_file), date.today().isoformat())


def _contours(settings: IdentifySettings, count: int) -> int:
    return 0 if settings.property is Property.SERVO_RESPONSE else min(count - 1, round(WALL * count))
