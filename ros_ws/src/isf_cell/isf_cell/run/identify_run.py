"""Identification on the simulated machine in one process: form a wall, then measure with the tools in the cell."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.controller import ForceController
from isf_identify.identification import Finding, finding, make_probe
from isf_identify.rig_piece import rig_reference
from isf_identify.settings import IdentifySettings, Property, ToolGeometry
from isf_planner import plan
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine

POSES = 50.0
"""Hz at which poses are reported, as the machine node does."""

WALL = 0.7
"""Share of the contours that are formed first, unless the caller says otherwise."""

Progress = Callable[[str, float], None]


def identify(
    job_file: JobFile,
    settings: IdentifySettings,
    *,
    contours: int | None = None,
    world: int = 0,
    seed: int = 0,
    progress: Progress | None = None,
    machine: SimulatedMachine | None = None,
) -> Finding:
    """What the tools find out about the simulated ``machine`` (None: one of ``world`` and ``seed``).

    ``contours`` are formed first (None: most of the part; none for the servo). Raises IsfError as planning, forming and
    the measurement do.
    """
    part = plan(job_file)
    machine = machine or SimulatedMachine(job_file, world=world, seed=seed)
    machine.tare()
    controller = ForceController(ControlConfig.from_job(job_file))
    sample = machine.sample()
    count = len(part.contours)
    controller.arm(part.plan_id, 0, count, sample.tip_1.tolist(), sample.tip_2.tolist())
    wanted = _contours(settings, count) if contours is None else contours
    if not 0 <= wanted < count:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"{wanted} contours cannot be formed before the identification",
            where="contours",
            advice=f"0 to {count - 1}",
        )
    for contour in part.contours[:wanted]:
        if progress:
            progress("forming a wall", contour.index / max(wanted, 1))
        controller.start(contour)
        sample = _run(controller, machine, sample, None)
        result = controller.take_result()
        if result is None or result.code:
            raise IsfError(ErrorCode(result.code if result else 1), result.message if result else "no result")
    probe = controller.measure(lambda rest: make_probe(rest, settings, ToolGeometry.from_job(job_file)))
    _run(controller, machine, sample, (lambda: progress(probe.phase, probe.progress)) if progress else None)
    return finding(probe, controller.config, job_file.rig, rig_reference(job_file), date.today().isoformat())


def _contours(settings: IdentifySettings, count: int) -> int:
    return 0 if settings.property is Property.SERVO_RESPONSE else min(count - 1, round(WALL * count))


def _run(
    controller: ForceController, machine: SimulatedMachine, sample: MachineSample, tell: Callable[[], None] | None
) -> MachineSample:
    every = max(1, round(machine.control_rate / POSES))
    while controller.busy:
        if sample.tick % every == 0:
            controller.add_measured(1, sample.time, sample.tip_1.tolist())
            controller.add_measured(2, sample.time, sample.tip_2.tolist())
        if tell and sample.tick % round(machine.control_rate) == 0:
            tell()
        pair = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
        sample = machine.tick(pair.tip_1, pair.tip_2, pair.holder_height)
        if machine.faults:
            code, text = machine.faults[0]
            raise IsfError(code, text, where="the simulated machine")
    return sample
