"""A whole part in one process, without DDS: the same cores in the same order as the node graph.

Used for fast simulation, parameter studies, the uncorrected reference of a report, and tests.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from isf_analysis.measures.contour_scan import ContourScan, kept_scan
from isf_analysis.measures.events import event_of
from isf_analysis.measures.record import PartRecord
from isf_core import __version__
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.measuring_controller import MeasuringController
from isf_planner import Plan, plan
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine
from isf_springback.corrector import Corrector, apply
from isf_springback.lift_feedback import lift_due, reading_of
from isf_springback.methods import check_method, make_corrector
from isf_springback.scan.feedback import scan_due

from isf_cell.options import RunOptions
from isf_cell.run.in_process_cell import lift_in_process, run_ticks, scan_in_process
from isf_cell.run.part_step import PartStep


@dataclass
class _History:
    nominal: list[Contour] = field(default_factory=list)
    corrected: list[Contour] = field(default_factory=list)
    corrections: list[ContourCorrection] = field(default_factory=list)
    results: list[ContourResult] = field(default_factory=list)
    scans: list[ContourScan] = field(default_factory=list)


def form(
    job_file: JobFile,
    options: RunOptions | None = None,
    *,
    part_plan: Plan | None = None,
    progress: Callable[[PartStep], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> PartRecord:
    """Plan (unless ``part_plan`` is given), form and scan one part; returns its record.

    A part that ends early (fault, cancel) returns what was formed, with the code in its last result; only
    faults before the first contour raise.

    Raises
    ------
    IsfError : planner, springback or force control refuse the job
    """
    options = options or RunOptions()
    options.check(job_file)
    check_method(options.method(job_file), job_file)  # before the plan, which takes its time
    started = time.perf_counter()
    part_plan = part_plan or plan(job_file)
    machine = SimulatedMachine(job_file, world=options.world, seed=options.seed)
    machine.tare()
    corrector = make_corrector(options.method(job_file), job_file)
    corrector.set_target(part_plan.target)
    controller = MeasuringController(ControlConfig.from_job(job_file, support_force=options.support_force))
    sample = machine.sample()
    controller.arm(part_plan.plan_id, 0, len(part_plan.contours), sample.tip_1.tolist(), sample.tip_2.tolist())

    history = _History()
    for nominal in part_plan.contours:
        sample = _form_contour(nominal, corrector, controller, machine, sample, history)
        result = history.results[-1]
        if progress:
            progress(PartStep.of(nominal, history.corrections[-1], result))
        if not result.completed:
            break
        if cancelled and cancelled():
            break
        if lift_due(job_file, nominal.index, nominal.count):
            rows, sample = lift_in_process(controller, machine, sample, result)
            corrector.add_lift(reading_of(rows), nominal.index)
        if scan_due(job_file, nominal.index, nominal.count):
            points, sample = scan_in_process(job_file, nominal, controller, machine, sample)
            corrector.add_scan(points, nominal.index)
            history.scans.append(kept_scan(nominal.index, sample.time, points))
        if controller.fault is not None:  # between two contours: told by the one before
            code, text = controller.fault
            history.results[-1] = replace(result, completed=False, code=int(code), message=text)
            break

    return PartRecord(
        job_name=job_file.job.name,
        job_text=job_file.text,
        plan_id=part_plan.plan_id,
        process=job_file.job.process,
        correction=options.method(job_file),
        support_force=options.set_point(job_file),
        world=options.world,
        seed=options.seed,
        control_rate=job_file.job.control.rate,
        lockstep=False,
        software=__version__,
        nominal=tuple(history.nominal),
        corrected=tuple(history.corrected),
        corrections=tuple(history.corrections),
        results=tuple(history.results),
        target=part_plan.target,
        scan=machine.measured_shape(),
        ticks=sample.tick,
        late_ticks=0,
        lost_messages=0,
        sim_time=sample.time,
        wall_time=time.perf_counter() - started,
        events=tuple(event_of(event) for event in machine.events),
        scans=tuple(history.scans),
    )


def _form_contour(
    nominal: Contour,
    corrector: Corrector,
    controller: MeasuringController,
    machine: SimulatedMachine,
    sample: MachineSample,
    history: _History,
) -> MachineSample:
    correction = corrector.correct(nominal)
    corrected = apply(nominal, correction)
    controller.start(corrected)
    sample = run_ticks(controller, machine, sample)
    result = controller.take_result()
    if result is None:
        raise IsfError(
            ErrorCode.CONTOUR_REJECTED,
            "the force controller ended without a result",
            where=contour_label(nominal.index),
        )
    corrector.add_result(corrected, result)
    history.nominal.append(nominal)
    history.corrected.append(corrected)
    history.corrections.append(correction)
    history.results.append(result)
    return sample
