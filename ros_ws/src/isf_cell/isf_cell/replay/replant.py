"""A recorded part formed again on the simulated machine, from its job and seed, with other parameters of its control:
from its begin on, or from one of its contours on, the ones before it as they were.

The contours are those that were recorded; machine, sheet, load cells and their noise are those of the recorded variant
and seed. What the sheet answers is computed anew, so this tells what the part would have become.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.measures.force_metrics import has_set_point
from isf_analysis.measures.record import PartRecord
from isf_core.contour import contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, springback_method
from isf_force_ctrl.control_config import ControlConfig
from isf_planner import Plan
from isf_springback.methods import check_method

from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_cell.replay.recorded_run import RecordedRun
from isf_cell.replay.what_if import SET_POINT, WhatIf
from isf_cell.run.part_change import PartChange
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

    A part whose plan holds no force anywhere is planned anew where one is to be held.

    Raises
    ------
    IsfError : FILE_FIELD (not a part of the simulated machine), what the job or its methods refuse
    """
    part = run.part
    check_simulated(run, "--replant")
    job_file = run.job_file(base, what_if.job_text(part.job_text))
    options = _options(run, job_file, what_if)
    config = ControlConfig.from_job(job_file, support_force=options.support_force)
    control = _differing(config, what_if.control(recorded_config(run, base, job_file)))
    part_plan = None if _needs_forces(part, job_file, what_if) else _plan(part)
    return in_process.form(
        job_file, options, part_plan=part_plan, control=control, progress=progress, cancelled=cancelled
    )


def check_simulated(run: RecordedRun, option: str) -> None:
    """Raise IsfError FILE_FIELD when ``option`` would have a part of a real machine formed again."""
    if not run.simulated:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "a part of a real machine cannot be formed again",
            where=str(run.path),
            advice=f"leave {option} out: its recorded forces are fed to the controller",
        )


def form_from(
    run: RecordedRun,
    change: PartChange,
    base: Path | None = None,
    *,
    progress: Callable[[PartStep], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> PartRecord:
    """The part of ``run`` as it was recorded up to the ``change``, and with it from there on; raises as
    :func:`form_again`."""
    check_simulated(run, "--from")
    job_file = run.job_file(base)
    options = run.options(job_file)
    config = ControlConfig.from_job(job_file, support_force=options.support_force)
    return in_process.form(
        job_file,
        options,
        part_plan=_plan(run.part),
        control=_differing(config, recorded_config(run, base, job_file)),
        change=change,
        progress=progress,
        cancelled=cancelled,
    )


def change_at(run: RecordedRun, what_if: WhatIf, base: Path | None, start: int) -> PartChange:
    """The changes ``what_if`` before contour ``start`` (from 0), of what they really change.

    Raises
    ------
    IsfError : FILE_FIELD, UNSTABLE_GAIN; what the job or its springback method refuses
    """
    what_if.check_mid_part()
    recorded = run.job_file(base)
    job_file = run.job_file(base, what_if.job_text(run.part.job_text))
    before = recorded_config(run, base, recorded)
    after = what_if.control(recorded_config(run, base, job_file))
    if SET_POINT in what_if.of_job:
        after = replace(after, set_point=_held_force(run, job_file, start))
        after.check()
    method = run.options(recorded).method(recorded)
    chosen = springback_method(job_file.job, what_if.method or method)
    correction = None
    if chosen != method or job_file.job.springback != recorded.job.springback:
        check_method(chosen, job_file)
        correction = chosen, job_file
    return PartChange(start, _differing(before, after), correction)


def _held_force(run: RecordedRun, job_file: JobFile, start: int) -> float:
    """N, support force of ``job_file`` for the contours from ``start`` on; raises IsfError FILE_FIELD."""
    force, where = job_file.job.support_force_at(), f"--what-if {SET_POINT}"
    if force < ControlConfig.contact_threshold:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"{force:g} N is no contact, and a part cannot change to position control in its middle",
            where=where,
            advice=f"at least {ControlConfig.contact_threshold:g} N; leave --from out to form the whole part so",
        )
    if not any(has_set_point(result) for result in run.part.results if result.index >= start):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"no contour from {contour_label(start)} on was formed under force control, and the plan says which are",
            where=where,
            advice=_where_force_is_held(run.part, start),
        )
    return force


def _where_force_is_held(part: PartRecord, start: int) -> str:
    held = [result.index for result in part.results if result.index < start and has_set_point(result)]
    whole = "leave --from out: the whole part is formed so"
    return f"--from 1 to {held[-1] + 1}, or {whole}" if held else whole


def _needs_forces(part: PartRecord, job_file: JobFile, what_if: WhatIf) -> bool:
    """True when ``job_file`` is to hold a force that the recorded contours have no place for: planned without one, all
    of them are under position control."""
    wanted = SET_POINT in what_if.of_job and job_file.job.support_force_at() > 0.0
    return wanted and not any(contour.force_controlled for contour in part.nominal)


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
    if SET_POINT in what_if.of_job:
        force = job_file.job.support_force_at()
    return RunOptions(what_if.method or recorded.correction, force, recorded.variant, recorded.seed, recorded.sheet)


def _plan(part: PartRecord) -> Plan | None:
    """The recorded contours as a plan; None where not all are recorded: it is planned again from the job."""
    if not part.nominal or len(part.nominal) < part.planned or part.target is None:
        return None
    no_mesh = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    return Plan(part.plan_id, part.nominal, part.target, no_mesh, (), preforms=part.preforms)


def _values(config: ControlConfig) -> dict[str, Any]:
    return {item.name: getattr(config, item.name) for item in fields(config)}


def _differing(config: ControlConfig, wanted: ControlConfig) -> dict[str, Any]:
    """Parameters of ``wanted`` that are not those of ``config``; the set-point is an option of the run."""
    return {
        name: value
        for name, value in _values(wanted).items()
        if value != getattr(config, name) and name != "support_force"
    }
