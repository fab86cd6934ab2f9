"""Plans with springback corrections in their contours, for machines that cannot correct while they form.

Contours as a recorded part was formed, with all that forces, lifts and scans had shown of it, or as a method corrects
them before anything is measured. Programs of them run on a plain CNC (Behera 2015; Ren 2018, appendix D). What they
cannot hold stands in ``Plan.origin``, which the head of a program tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count, takewhile
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.open_bag import bag_of
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.surface_distance import Surface
from isf_core import __version__
from isf_core.contour import Contour, ContourCorrection, contour_label
from isf_core.errors import ErrorCode, IsfError, failure
from isf_core.files.job import Job, JobFile, springback_method
from isf_core.files.rig import Rig
from isf_core.geometry.height_map import HeightMap
from isf_planner import Plan
from isf_planner.checks.backing_plate import check_backing_plate
from isf_planner.checks.part_checks import check_machine
from isf_planner.paths.spindle import spindle_speeds
from isf_springback.corrector import apply
from isf_springback.estimators import learning
from isf_springback.methods import make_corrector

from isf_cell.options import UNCORRECTED
from isf_cell.replay.recorded_run import recorded_job

NOT_IN_IT = "not in it: force control, compliance compensation, on-line correction, lifts and scans that measure"
HOW_TO_GET_IT = (
    "for corrected ones: isf tryout JOB, or isf simulate JOB (isf form JOB), and then isf plan FOLDER --export FILE "
    "with the folder of that"
)


@dataclass(frozen=True)
class CorrectedPlan:
    """A plan whose contours are corrected, where they can be.

    Attributes
    ----------
    plan : with these contours, and ``origin`` ; method : springback method
    corrected : they differ from the plan as it is without a correction
    largest : m, largest correction of a point
    remarks : what to know before a program of it is used
    rig : of the part; None: cannot be had any more, for the reason ``rig_lost``
    """

    plan: Plan
    method: str
    corrected: bool
    largest: float
    remarks: tuple[str, ...]
    rig: Rig | None = None
    rig_lost: IsfError | None = None

    def numbers(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "corrected": self.corrected,
            "method": self.method,
            "largest_correction_mm": 1e3 * self.largest,
            "origin": list(self.plan.origin),
            "remarks": list(self.remarks),
        }


def uncorrected(plan: Plan, job_file: JobFile, why: str = "") -> CorrectedPlan:
    """The ``plan`` of a job as it is; ``why`` it is so although its method corrects."""
    job, method = job_file.job, springback_method(job_file.job)
    said = "not corrected" if method == UNCORRECTED else "NOT CORRECTED"
    origin = (f"contours of {job.name} as planned, {said} for springback", *([why] if why else []), *_planned(job))
    remarks = (f"the exported contours are NOT corrected for springback: {why}; {HOW_TO_GET_IT}",) if why else ()
    return CorrectedPlan(replace(plan, origin=origin), method, False, 0.0, remarks, job_file.rig)


def corrected_ahead(plan: Plan, job_file: JobFile) -> CorrectedPlan:
    """The ``plan`` of a job with the corrections that its method makes before anything is measured.

    The plan as it is, with a remark, where its method has none such. A job that scans between its contours is corrected
    as before its first scan.

    Raises
    ------
    IsfError : METHOD_UNKNOWN, LEARNING_UNUSABLE and what else the method refuses; PART_DOES_NOT_FIT and as
        :func:`isf_planner.checks.part_checks.check_machine`, where the rig cannot go so far
    """
    job = job_file.job
    method = springback_method(job)
    if method == UNCORRECTED:
        return uncorrected(plan, job_file)
    corrector = make_corrector(method, job_file)
    if not corrector.estimator.open_loop:
        return uncorrected(plan, job_file, f"method {method} corrects by what is measured while a part is formed")
    corrector.set_target(plan.target, plan.preforms)
    corrections = [corrector.correct(contour) for contour in plan.contours]
    stays = corrector.support_stays
    contours = tuple(
        apply(contour, correction, support_stays=stays)
        for contour, correction in zip(plan.contours, corrections, strict=True)
    )
    check_machine(contours, job, job_file.rig)
    remarks = _not_corrected(corrections)
    try:
        check_backing_plate(contours, job)
    except IsfError as error:  # the sheet is meant to give way to what a correction presses deeper
        remarks += (f"corrected, {error.what} ({error.where}): look at that place first",)
    origin = (
        f"contours of {job.name} corrected for springback by method {method}, before any measurement",
        *_learned_from(job_file),
        *_planned(job),
    )
    corrected = replace(plan, contours=contours, origin=origin, tree=None)
    largest = _largest(corrections)
    return CorrectedPlan(corrected, method, largest > 0.0, largest, remarks, job_file.rig)


def _learned_from(job_file: JobFile) -> tuple[str, ...]:
    """Line of the origin on the correction file of a job, if it names one."""
    name = job_file.job.springback.learning
    if name is None:
        return ()
    source = learning.load(job_file.base / name).source
    return (f"correction file {Path(name).name}{f', from: {source}' if source else ''}",)


def _planned(job: Job) -> tuple[str, ...]:
    """Lines of the origin that all plans of a job have."""
    given = f", compensated for {', '.join(job.path.compensation)}" if job.path.compensation else ""
    return f"planned with ISF {__version__}{given}", NOT_IN_IT


def as_formed(
    run: Path,
    namespace: str | None = None,
    base: Path | None = None,
    *,
    incomplete: bool = False,
    nominal: bool = False,
) -> CorrectedPlan:
    """The contours as the part in the ``run`` folder, or bag, was formed with them.

    Parameters
    ----------
    namespace : cell that is meant, where the bag holds several
    base : folder that paths in the recorded job refer to; None: the recorded one
    incomplete : also of a part that tore or ended early: its first contours, as far as they were all formed
    nominal : the contours as they were planned instead

    Raises
    ------
    IsfError : BAG_UNREADABLE, BAG_INCOMPLETE, FILE_FIELD (as :func:`isf_analysis.bag.bag_reader.read_bag`); the code of
        what ended the part or tore it, BAG_INCOMPLETE where that or a contour is not recorded; CONTOUR_REJECTED, a
        contour of the bag is malformed
    """
    record = read_bag(run, namespace)
    source = record.nominal if nominal else record.corrected
    contours, ended = _in_a_row(record, source, run)
    if ended is not None and not incomplete:
        raise IsfError(
            ended.code,
            f"no program of a part that is not whole: {ended.what}",
            where=str(run),
            advice="form it again; --incomplete: a program of the contours up to there, all the same",
        )
    if not contours:
        raise ended or IsfError(ErrorCode.BAG_INCOMPLETE, "holds no contour that was formed", where=str(run))
    job, rig, lost = _job_of(record, base)
    if rig is None and lost is not None and any(contour.tilted for contour in contours) and job is None:
        raise lost  # the programs of a tilted tool need the radius of its ball
    applied = [step for step in record.corrections if step.index < len(contours)]
    largest = 0.0 if nominal else _largest(applied)
    corrected = not nominal and record.corrects
    remarks = _remarks(record, applied, ended, len(contours), nominal=nominal)
    plan = Plan(
        record.plan_id,
        contours,
        record.target or NO_TARGET,
        _mesh_of(record.target),
        record.plan_warnings,
        ball_radius=job.tool_1.ball_radius if job is not None else float("nan"),
        preforms=record.preforms,
        hold_after=job.path.hold_after if job is not None else (),
        origin=_origin_of(record, run, ended, len(contours), nominal=nominal),
        spindle=spindle_speeds(contours, job) if job is not None else (),
    )
    return CorrectedPlan(plan, record.correction or UNCORRECTED, corrected, largest, remarks, rig, lost)


NO_TARGET = HeightMap(np.array([-1.0, 1.0]), np.array([-1.0, 1.0]), np.full((2, 2), np.nan))
"""Target of a plan whose bag holds none."""


def _in_a_row(record: PartRecord, source: Sequence[Contour], run: Path) -> tuple[tuple[Contour, ...], IsfError | None]:
    """Contours of ``source`` from the first one on that were formed and are recorded, and what ended the part there."""
    known = {contour.index: contour.validate() for contour in source}
    formed = {result.index for result in record.results if result.completed}
    row = tuple(known[k] for k in takewhile(lambda k: k in known and k in formed, count()))
    early = record.failure()
    if early is not None:
        code, text = early
        return row, failure(code or ErrorCode.BAG_INCOMPLETE, text, where=str(run), otherwise=ErrorCode.BAG_INCOMPLETE)
    if len(row) < record.planned:
        text = f"{contour_label(len(row))} is not in the bag as it was formed"
        return row, IsfError(ErrorCode.BAG_INCOMPLETE, text, where=str(run))
    return row, None


def _job_of(record: PartRecord, base: Path | None) -> tuple[Job | None, Rig | None, IsfError | None]:
    """The recorded job and its rig, as far as they can be had, and why not."""
    try:
        job_file = recorded_job(record, base)
    except IsfError as lost:
        try:
            return record.job(), None, lost
        except IsfError:
            return None, None, lost
    return job_file.job, job_file.rig, None


def _largest(corrections: Sequence[ContourCorrection]) -> float:
    """m, of the offsets of all points."""
    return max(
        (float(np.linalg.norm(step.offset, axis=1).max()) for step in corrections if len(step.offset)), default=0.0
    )


def _not_corrected(corrections: Sequence[ContourCorrection]) -> tuple[str, ...]:
    """Remark on contours whose correction is not the one that was asked for."""
    lost = [step for step in corrections if step.code]
    if not lost:
        return ()
    first = f"{contour_label(lost[0].index)}: {lost[0].message}"
    return (f"{len(lost)} of {len(corrections)} contours were not corrected as they should have been; {first}",)


def _remarks(
    record: PartRecord, applied: Sequence[ContourCorrection], ended: IsfError | None, left: int, *, nominal: bool
) -> tuple[str, ...]:
    remarks: list[str] = []
    if ended is not None:
        remarks.append(f"a program of {left} of {record.planned} contours: {ended.what}")
    if nominal:
        return (*remarks, "the contours are those of the plan, NOT corrected for springback, as was asked for")
    if not record.corrects:
        remarks.append(f"the part was formed without a correction: its contours are those of the plan; {HOW_TO_GET_IT}")
    return (*remarks, *_not_corrected(applied), *record.warned.values())


def _origin_of(record: PartRecord, run: Path, ended: IsfError | None, left: int, *, nominal: bool) -> tuple[str, ...]:
    if nominal:
        first = "as planned, NOT CORRECTED for springback"
    elif record.corrects:
        first = f"as they were formed, corrected for springback by method {record.correction}"
    else:
        first = "as they were formed, without a correction for springback"
    incomplete = (f"INCOMPLETE: {left} of {record.planned} contours: {ended.what}",) if ended is not None else ()
    return (
        *incomplete,
        f"contours of {record.job_name} {first}",
        f"formed on: {record.plant}; run {_name_of(run)}, ISF {record.software or __version__}",
        NOT_IN_IT,
    )


def _name_of(run: Path) -> str:
    """Of the folder of a run, also where its bag is named; of another bag with that of the folder it is in."""
    path = run.resolve()
    if bag_of(path) != path:
        return path.name
    return path.parent.name if path.name == "bag" else f"{path.parent.name}/{path.name}"


def _mesh_of(target: HeightMap | None) -> tuple[Any, Any]:
    """Vertices (V, 3) m and faces (F, 3) of the part, on the grid of the recorded ``target``."""
    nothing = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    if target is None:
        return nothing
    try:
        surface = Surface.of_height_map(HeightMap(target.x, target.y, target.z))
    except IsfError:
        return nothing
    part = surface.faces[(np.abs(surface.corners[:, :, 2]) > 0.0).any(axis=1)]
    used, faces = np.unique(part, return_inverse=True)
    return (surface.vertices[used], faces.reshape(-1, 3)) if len(part) else nothing
