"""Planning a part: from the job file to contours, tool tips and the target surface.

The last step adds forces and limits along the contours, then the compensation that needs no feedback.
"""

from __future__ import annotations

from dataclasses import replace

from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile

from isf_planner import processes, replanning
from isf_planner.accuracy.moved_target import MovedTarget, compensated
from isf_planner.checks import backing_plate, part_checks
from isf_planner.checks.shank_checks import check_shank, check_upright
from isf_planner.forming import stages
from isf_planner.forming.sides import merged
from isf_planner.gcode.program_job import plan_of_program
from isf_planner.part import mesh_checks
from isf_planner.part.meshes import Mesh
from isf_planner.part_plan import Plan
from isf_planner.paths import support_tool, tool_paths
from isf_planner.paths.five_axis import tilt_warning, with_tool_axis
from isf_planner.paths.spindle import spindle_speeds
from isf_planner.predict.compensation import compensate
from isf_planner.predict.predictions import with_predictions
from isf_planner.processes import Cancelled, Progress, Steps, process_of
from isf_planner.replanning import PlanBase
from isf_planner.surface import target_surface

OF_SHAPE = (ErrorCode.WALL_TOO_STEEP, ErrorCode.PART_TOO_SMALL_FOR_TOOL)
"""Faults that a part may have only because accuracy surfaces move its target."""


def finish(contours: tuple[Contour, ...], job_file: JobFile) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
    """Contours with predicted forces, compensated tips and the axis of a tilted tool, and warnings with their place."""
    filled, warnings = with_predictions(contours, job_file)
    moved, reported = compensate(filled, job_file) if job_file.job.path.compensation else (filled, ())
    if not job_file.tilts:
        return moved, (*warnings, *reported)
    tilted = with_tool_axis(moved, job_file)
    return tilted, (*warnings, *reported, *tilt_warning(tilted, job_file))


def plan(job_file: JobFile, *, progress: Progress | None = None, cancelled: Cancelled | None = None) -> Plan:
    """Plan the part of a job, or take its program as the plan.

    Parameters
    ----------
    job_file : the job with its rig, material and mesh path
    progress : called with a phase for people and the finished part 0..1
    cancelled : asked between the phases and levels

    Raises
    ------
    IsfError : codes 1101-1112 with the place and an advice; PLAN_CANCELLED; of a program as :func:`plan_of_program`
    """
    job, rig = job_file.job, job_file.rig
    step = Steps(progress or (lambda phase, share: None), cancelled or (lambda: False))
    if job_file.program is not None:
        return plan_of_program(job_file, step)
    step("reading the mesh", 0.0)
    loaded, repaired = mesh_checks.load_part(job_file)
    warnings = list(repaired)
    process = process_of(job)
    moved = _moved(loaded, job_file, step) if job.accuracy_surfaces is not None else None
    try:
        part = process.prepare(moved.moved if moved else loaded, job_file, step)
    except IsfError as error:
        if moved is None or error.code not in OF_SHAPE:
            raise
        what = f"{error.what}; so it is with the target that part.accuracy_surfaces moves"
        advice = f"leave part.accuracy_surfaces out, or {error.advice}"
        raise IsfError(error.code, what, where=error.where, advice=advice) from error
    planned = list(part.sides)
    warnings += [*part.warnings, *(moved.warnings if moved else ())]
    if job.path.islands == "swap":
        part_checks.check_islands(planned)
        warnings += part_checks.left_by_springback(planned, job)
    part_warnings = tuple(warnings)
    step("tools", 0.9)
    plan_id = processes.plan_id(job_file)
    made, reported = process.contours(part, job_file, plan_id)
    contours, waits = support_tool.waiting(made, job)
    warnings += (*reported, *waits)
    warnings += (*tool_paths.left_out(contours, job), *support_tool.rule_warnings(contours, planned, job_file))
    contours, expected = finish(contours, job_file)
    warnings += (*tool_paths.left_to_sine_law(planned, job), *expected)
    formed = stages.with_sheet(part.stages, contours, job_file) if part.stages else ()
    warnings += stages.strain_warnings(formed, job_file) if formed else ()
    part_checks.check_machine(contours, job, rig)
    backing_plate.check_backing_plate(contours, job)
    nominal = moved.nominal if moved else part.mesh
    warnings += backing_plate.check_held(contours, nominal, job, rig)
    last = tuple(contour for contour in contours if contour.stage == len(part.preforms))
    warnings += part_checks.check_slopes(last, job)
    part_checks.check_floors(last, planned, job)
    warnings += part_checks.check_support(last, planned, job)
    target = target_surface.target_map(nominal, rig.clamp.size)
    shank, near = check_shank(contours, target, job_file) if job_file.tilts else (None, ())
    warnings += near
    warnings += check_upright(last, planned, target, job_file) if _beyond_tip(job) else ()
    step("done", 1.0)
    base = PlanBase(job, tuple(planned), part_warnings)
    unique = tuple(dict.fromkeys(warnings))
    mesh = nominal.vertices, nominal.faces
    partial = tuple(side.partial for side in (*part.preforms, *planned) if side.partial is not None)
    ball, tree = job.tool_1.ball_radius, merged(planned)
    return Plan(
        plan_id,
        contours,
        target,
        mesh,
        unique,
        formed,
        partial,
        tree,
        base,
        shank,
        ball,
        moved,
        tuple(target_surface.on_grid(stage.heights, target) for stage in part.stages[: len(part.preforms)]),
        job.path.hold_after,
        spindle=_spindle(contours, job),
    )


def replan(before: Plan, job_file: JobFile) -> Plan:
    """The plan of ``before`` for a job with other tools, sheet thickness, feed, paths or control, in milliseconds.

    Contacts, normals and curvatures are kept (:mod:`isf_planner.replanning`). Where the job changes what they depend
    on (part, levels, process, rig), a smaller tool gets where the one before did not, or the process keeps none (TPIF,
    ADSIF), the part is planned anew.

    Raises
    ------
    IsfError : as :func:`plan`; PART_TOO_SMALL_FOR_TOOL where the new tool does not fit
    """
    base, job = before.base, job_file.job
    staged = before.stages or job.path.stages or job.path.morph or job.path.finishing_passes
    partial = before.partial or job.path.partial_paths
    if base is None or base.job.path.finishing_passes or staged or partial or before.moved or job.strategy:
        return plan(job_file)
    if not replanning.same_contacts(base.job, job) or replanning.reaches_further(base, job):
        return plan(job_file)
    mesh = Mesh(*before.mesh)
    part_checks.check_fit(mesh_checks.PlacedPart(mesh, -float(mesh.vertices[:, 2].min()), ()), job, job_file.rig)
    sides = replanning.with_tools(base, job)
    plan_id = processes.plan_id(job_file)
    made, waits = support_tool.waiting(tool_paths.make_contours(list(sides), job_file, plan_id), job)
    ruled = support_tool.rule_warnings(made, sides, job_file)
    contours, expected = finish(made, job_file)
    part_checks.check_machine(contours, job, job_file.rig)
    backing_plate.check_backing_plate(contours, job)
    held = (*backing_plate.check_held(contours, mesh, job, job_file.rig), *part_checks.check_slopes(contours, job))
    part_checks.check_floors(contours, sides, job)
    pressing = part_checks.check_support(contours, sides, job)
    shank, near = check_shank(contours, before.target, job_file) if job_file.tilts else (None, ())
    pressing += near
    pressing += check_upright(contours, sides, before.target, job_file) if _beyond_tip(job) else ()
    left = tool_paths.left_to_sine_law(sides, job)
    reported = tuple(dict.fromkeys((*base.reported, *waits, *ruled, *left, *expected, *held, *pressing)))
    tree, ball = merged(sides), job.tool_1.ball_radius
    return replace(
        before,
        plan_id=plan_id,
        contours=contours,
        warnings=reported,
        tree=tree,
        shank=shank,
        ball_radius=ball,
        hold_after=job.path.hold_after,
        spindle=_spindle(contours, job),
    )


def _spindle(contours: tuple[Contour, ...], job: Job) -> tuple[float, ...]:
    return spindle_speeds(contours, job) if job.path.spindle != "none" else ()


def _beyond_tip(job: Job) -> bool:
    """Whether the job tells of anything of a tool that may reach further to the side than its tip."""
    tools = [tool for tool in (job.tool_1, job.tool_2) if tool is not None]
    return any(tool.holder or tool.stick_out or (tool.shank_radius or 0.0) > tool.radius for tool in tools)


def _moved(loaded: Mesh, job_file: JobFile, step: Steps) -> MovedTarget:
    """The part ``loaded``, placed, with its target moved by the accuracy surfaces of the job."""
    step("accuracy surfaces", 0.0)
    job, clamp = job_file.job, job_file.rig.clamp.size
    placed = mesh_checks.check_and_place(loaded, clamp, job.tool_1.radius, place=job.place)
    made = compensated(placed.mesh, job_file)
    return replace(made, warnings=(*placed.warnings, *made.warnings))
