"""A job whose path is a program, ``path: {program: FILE}``: the program is its plan, checked by line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap

from isf_planner.gcode.program_check import CheckedProgram, checked
from isf_planner.gcode.reader import program_text, read_program
from isf_planner.gcode.set_up import SetUp, cell_set_up, load_set_up
from isf_planner.part import mesh_checks
from isf_planner.part.mesh_checks import place_text
from isf_planner.part_plan import Plan
from isf_planner.processes import Steps
from isf_planner.surface import target_surface

FAR_FROM_PART = 1e-3
"""m between contacts of a program and the part of its job that is worth a warning. Normals at the rim and at a floor,
from which contacts come, are known to 0.5 mm."""


def plan_of_program(job_file: JobFile, step: Steps) -> Plan:
    """Plan of a job with a program; its target is the part where the job has one, else the surface of the contacts.

    Raises
    ------
    IsfError : the first thing that is at fault in the program, with its line; as
        :func:`isf_planner.gcode.program_plan.program_plan`; of the set-up; PLAN_CANCELLED
    """
    step("reading the program", 0.0)
    found = check_job_program(job_file)
    process = "DSIF" if found.program.two_tools else "SPIF"
    if found.failure is None and job_file.job.process != process:
        tools = "two tools" if found.program.two_tools else "one tool"
        raise IsfError(
            ErrorCode.PROCESS_NOT_SUPPORTED,
            f"the program moves {tools}, and the process of the job is {job_file.job.process}",
            where=found.program.name,
            advice=f"write process: {process}",
        )
    failure = found.failure
    if failure is not None:
        raise _with_count(failure, found)
    plan = found.plan
    assert plan is not None  # nothing is at fault
    warnings = (*found.program.remarks, *plan.warnings)
    target, mesh = plan.target, plan.mesh
    if job_file.mesh is not None:
        step("reading the mesh", 0.6)
        target, mesh, more = _part(job_file)
        warnings = (*warnings, *more, *_far_from_part(plan, target))
    step("done", 1.0)
    return replace(plan, target=target, mesh=mesh, warnings=tuple(dict.fromkeys(warnings)))


def check_job_program(job_file: JobFile) -> CheckedProgram:
    """The program of a job, read with its set-up and held against the job; raises IsfError of files."""
    job = job_file.job
    assert job_file.program is not None
    set_up = _set_up(job_file)
    text = program_text(job_file.program, "path.program is relative to the job file")
    spacing, feed = job.path.point_spacing, job.path.feed
    program = read_program(text, set_up, name=job_file.program.name, step=spacing, feed=feed)
    return checked(program, job_file, set_up, job.tool_1)


def _set_up(job_file: JobFile) -> SetUp:
    named = job_file.job.path.set_up
    return cell_set_up(job_file.rig.name)[0] if named is None else load_set_up(job_file.base / named)


def _with_count(failure: IsfError, found: CheckedProgram) -> IsfError:
    """``failure`` with how much else is at fault."""
    more = found.program.unknown_count + len(found.findings) - 1
    if not more:
        return failure
    advice = f"{failure.advice}; {more} more at fault in the program: isf gcode FILE --job JOB tells all by line"
    return IsfError(failure.code, failure.what, where=failure.where, advice=advice)


def _part(job_file: JobFile) -> tuple[HeightMap, tuple[np.ndarray, np.ndarray], tuple[str, ...]]:
    loaded, repaired = mesh_checks.load_part(job_file)
    clamp = job_file.rig.clamp.size
    radius = job_file.job.tool_1.radius
    placed = mesh_checks.check_and_place(loaded, clamp, radius, place=job_file.job.place)
    mesh = placed.mesh
    return target_surface.target_map(mesh, clamp), (mesh.vertices, mesh.faces), (*repaired, *placed.warnings)


def _far_from_part(plan: Plan, target: HeightMap) -> tuple[str, ...]:
    contact = np.concatenate([contour.contact for contour in plan.contours])
    off = contact[:, 2] - target.at(contact[:, :2])
    worst = int(np.nanargmax(np.abs(off)))
    if abs(off[worst]) < FAR_FROM_PART:
        return ()
    what = (
        f"the program touches the sheet up to {1e3 * abs(off[worst]):.1f} mm {'above' if off[worst] > 0 else 'below'} "
    )
    return (
        f"{what}the part, at {place_text(contact[worst])}: is it the program of this part, and its work offset right?",
    )
