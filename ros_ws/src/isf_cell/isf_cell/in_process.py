"""A whole part in one process, without DDS: the same cores in the same order as the node graph.

Used for fast simulation, parameter studies, the uncorrected reference of a report, and tests.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from isf_analysis.measures.record import PartRecord
from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_planner import Plan

from isf_cell.options import RunOptions
from isf_cell.run.cell import PartGoal
from isf_cell.run.in_process_cell import InProcessCell
from isf_cell.run.part_change import PartChange
from isf_cell.run.part_run import PartRun
from isf_cell.run.part_step import PartStep


@dataclass(frozen=True)
class _Operator:
    progress: Callable[[PartStep], None] | None
    stopped: Callable[[], bool] | None
    told: Callable[[str], None] | None

    def phase(self, text: str, index: int = 0, count: int = 0) -> None:
        """Nobody looks."""

    def warned(self, text: str) -> None:
        if self.told:
            self.told(text)

    def formed(self, step: PartStep) -> None:
        if self.progress:
            self.progress(step)

    def cancelled(self) -> bool:
        return self.stopped is not None and self.stopped()

    def paused(self) -> bool:
        return False


def form(
    job_file: JobFile,
    options: RunOptions | None = None,
    *,
    part_plan: Plan | None = None,
    control: Mapping[str, object] | None = None,
    change: PartChange | None = None,
    progress: Callable[[PartStep], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    warned: Callable[[str], None] | None = None,
) -> PartRecord:
    """Plan (unless ``part_plan`` is given), form and scan one part; returns its record.

    ``control`` : parameters of force control (ControlConfig) in place of the job's and the defaults
    ``change`` : settings that change in the middle of the part
    ``warned`` : gets each warning of the planner, before the part is formed

    A part that ends early (fault, cancel) returns what was formed, with the code in its last result; only
    faults before the first contour raise. A part whose final scan fails has none; the log says why.

    Raises
    ------
    IsfError : planner, springback or force control refuse the job
    """
    options = options or RunOptions()
    started = time.perf_counter()
    cell = InProcessCell(part_plan, control=control, change=change)
    error = PartRun(cell, PartGoal(job_file, options), _Operator(progress, cancelled, warned)).run()
    reported = (
        error is None
        or error.code in (ErrorCode.CANCELLED, ErrorCode.SHEET_TORN)
        or (cell.results and not cell.results[-1].completed)
    )
    if error is not None and not reported:
        raise error
    scan = _final_scan(cell)
    part_plan = cell.part_plan
    assert part_plan is not None  # the part was planned
    return PartRecord(
        job_name=job_file.job.name,
        job_text=job_file.text,
        plan_id=part_plan.plan_id,
        process=job_file.job.process,
        correction=options.method(job_file),
        support_force=options.set_point(job_file),
        variant=options.variant,
        seed=options.seed,
        control_rate=job_file.job.control.rate,
        lockstep=False,
        software=__version__,
        nominal=tuple(cell.nominal),
        corrected=tuple(cell.corrected),
        corrections=tuple(cell.corrections),
        results=tuple(cell.results),
        target=part_plan.target,
        preforms=part_plan.preforms,
        scan=scan,
        ticks=cell.sample.tick,
        late_ticks=0,
        lost_messages=0,
        sim_time=cell.sample.time,
        wall_time=time.perf_counter() - started,
        events=cell.events,
        scans=tuple(cell.scans),
        sheet=cell.machine.sheet_values(),
        base_folder=str(job_file.base.resolve()),
        plan_warnings=tuple(part_plan.warnings),
        tool_compliance=(job_file.rig.tool_1.compliance, job_file.rig.tool_2.compliance),
        axis_error=cell.machine.legs.following() if cell.machine.legs is not None else None,
        formed_sheet=cell.machine.thinned_sheet(scan) if scan is not None else None,
        released=_released(cell) if options.release and error is None else None,
    )


def _released(cell: InProcessCell) -> Array | None:
    try:
        points = cell.machine.released_shape().points()
    except IsfError as error:
        logging.getLogger(__name__).warning("no scan of the part out of the clamp: %s", error)
        return None
    return points[np.isfinite(points[:, 2])]


def _final_scan(cell: InProcessCell) -> HeightMap | None:
    try:
        return cell.machine.measured_shape()
    except IsfError as error:
        logging.getLogger(__name__).warning("no scan of the finished part: %s", error)
        return None
