"""A recorded part formed again on the simulated machine, from its job and seed, with other parameters of its control.

The contours are those that were recorded; machine, sheet, load cells and their noise are those of the recorded variant
and seed. What the sheet answers is computed anew, so this tells what the part would have become.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.measures.record import PartRecord
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_force_ctrl.control_config import ControlConfig
from isf_planner import Plan

from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.replay.recorded_run import RecordedRun
from isf_cell.replay.what_if import WhatIf
from isf_cell.run.part_step import PartStep


def form_again(
    run: RecordedRun,
    what_if: WhatIf,
    base: Path | None = None,
    *,
    progress: Callable[[PartStep], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> PartRecord:
    """The part of ``run`` with the changes ``what_if``; ``base``: folder that the job's paths refer to.

    Raises
    ------
    IsfError : FILE_FIELD (not a part of the simulated machine), what the job or its methods refuse
    """
    part = run.part
    if not run.simulated:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "a part of a real machine cannot be formed again",
            where=str(run.path),
            advice="leave --replant out: its recorded forces are fed to the controller",
        )
    job_file = run.job_file(base, what_if.job_text(part.job_text))
    options = _options(run, job_file, what_if)
    config = ControlConfig.from_job(job_file, support_force=options.support_force)
    control = _differing(config, what_if.control(recorded_config(run, base, job_file)))
    return in_process.form(
        job_file, options, part_plan=_plan(part), control=control, progress=progress, cancelled=cancelled
    )


def recorded_config(run: RecordedRun, base: Path | None, job_file: JobFile) -> ControlConfig:
    """Parameters of force control of ``job_file``, which may differ from the recorded job, with those that the run had
    set beside its job."""
    config = ControlConfig.from_job(job_file)
    if run.armed is None:
        return config
    set_beside = _differing(ControlConfig.from_job(run.job_file(base)), run.armed.config)
    return ControlConfig(**{**_values(config), **set_beside})


def _options(run: RecordedRun, job_file: JobFile, what_if: WhatIf) -> RunOptions:
    recorded = run.options(run.job_file(job_file.base))
    force = recorded.support_force
    if "control.support_force" in what_if.of_job:
        force = job_file.job.support_force_at()
    return RunOptions(what_if.method or recorded.correction, force, recorded.variant, recorded.seed, recorded.sheet)


def _plan(part: PartRecord) -> Plan | None:
    """The recorded contours as a plan; None where not all are recorded: it is planned again from the job."""
    if not part.nominal or len(part.nominal) < part.planned or part.target is None:
        return None
    return Plan(part.plan_id, part.nominal, part.target, (np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)), ())


def _values(config: ControlConfig) -> dict[str, Any]:
    return {item.name: getattr(config, item.name) for item in fields(config)}


def _differing(config: ControlConfig, wanted: ControlConfig) -> dict[str, Any]:
    """Parameters of ``wanted`` that are not those of ``config``; the set-point is an option of the run."""
    return {
        name: value
        for name, value in _values(wanted).items()
        if value != getattr(config, name) and name != "support_force"
    }
