"""``isf learn``: corrections for the next part, or for other parts, from the records of parts formed before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.record import PartRecord
from isf_core.contour import Contour, ContourCorrection
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_planner.accuracy import formed_parts
from isf_planner.accuracy.formed_parts import Conditions, FormedPart, FormedParts, formed_part
from isf_planner.accuracy.surfaces import with_held_out
from isf_planner.planning import plan
from isf_springback.estimators import learning
from isf_springback.estimators.learning import Learned, learn_part
from isf_springback.loop_path import forming_radius
from isf_springback.scan import FormedShape
from isf_springback.scan.feedback import ScanMemory
from isf_springback.scan.formed_shape import ANY_SCALE, FORMED_SCALE

from isf_cell.bench_scan import ALIGNMENTS, BenchScan, read_bench_scan
from isf_cell.commands import terminal
from isf_cell.corrected_plan import corrected_ahead, uncorrected
from isf_cell.replay.recorded_run import recorded_job

UNMODELLED = ("none", "learned", "learned_map")
"""Methods of springback that correct nothing, or what parts before showed: no model of the sheet."""


def learn_runs(runs: list[Path], output: Path, base: Path | None, *, as_json: bool) -> None:
    """Learn from ``runs`` (folders of runs or bags, oldest first) on top of ``output`` when it exists, and write it.

    ``base`` : folder that the paths in the recorded jobs refer to (rig and material files of one's own), None: the
    recorded one of each

    Raises
    ------
    IsfError : BAG_UNREADABLE, LEARNING_UNUSABLE, codes of a job, codes of scan processing
    """
    for job in filter(is_job, runs):
        what, advice = "is a job, which holds no shape", "name its runs, or add --scan FILE, a scan of the part"
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, what, where=str(job), advice=advice)
    known = learning.load(output) if output.exists() else None
    for run in runs:
        known = learn_record(read_bag(run), base, known)
        _tell(known, run)
    if known is None:
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, "no run was given", advice="isf learn RUN... -o FILE")
    _keep(known, output, {}, as_json=as_json)


def _tell(known: Learned, part: Path) -> None:
    mean, largest = 1e3 * known.history[-1]
    terminal.say(
        f"{part}: part {known.parts} of {known.job}, error of wall and floor {mean:.2f} mm mean, {largest:.2f} mm "
        f"largest; {known.scanned or 'no'} of {known.contours} contours scanned"
    )


def _keep(known: Learned, output: Path, more: dict[str, Any], *, as_json: bool) -> None:
    learning.save(known, output)
    if as_json:
        terminal.print_json(
            {
                "file": str(output),
                "job": known.job,
                "parts": known.parts,
                "mean_error_mm": terminal.without_nan((1e3 * known.history[:, 0]).tolist()),
                "largest_push_mm": float(1e3 * np.abs(known.push).max()),
                "samples": len(known.springback),
                "scanned_contours": known.scanned,
            }
            | more
        )
    terminal.say(f"learned {output}: name it in the job as springback.learning, with method learned")


@dataclass(frozen=True)
class Bench:
    """What is told of a scan from a bench: its file, ``unit``, how it lies (``align``: clamp, fit, None: fit of a part
    out of the clamp, else clamp); ``released``: the part is out of the clamp, and moved as the part of the run
    ``release_of``; ``as_planned``: it was formed without a correction."""

    scan: Path
    unit: str | None = None
    align: str | None = None
    released: bool = False
    release_of: Path | None = None
    as_planned: bool = False


def learn_scan(part: Path, bench: Bench, output: Path, base: Path | None, *, as_json: bool) -> None:
    """Learn from a scan of the ``part`` from a bench on top of ``output`` when it exists, and write it.

    ``part`` : run or bag that tells with what contours it was formed, or its job: then with those of
    ``isf plan JOB --export`` ; ``base`` as in :func:`learn_runs`

    Raises
    ------
    IsfError : FILE_FIELD, LEARNING_UNUSABLE, codes of the run or the job, of
        :func:`isf_cell.bench_scan.read_bench_scan` and of scan processing
    """
    released = bench.released or bench.release_of is not None
    align = bench.align or ("fit" if released else "clamp")
    if align not in ALIGNMENTS:
        raise IsfError(ErrorCode.FILE_FIELD, f"no alignment '{align}'", where="--align", advice="clamp or fit")
    known = learning.load(output) if output.exists() else None
    formed = _formed_by_job(part, as_planned=bench.as_planned) if is_job(part) else _formed_by_run(part, base)
    like = read_bag(bench.release_of) if bench.release_of is not None else None
    clamp = formed.job_file.rig.clamp.size
    found = read_bench_scan(bench.scan, bench.unit, formed.target, clamp, align=align, released=released, like=like)
    try:
        known = _learned(formed, found.points, known, clamped=not released, least_scale=FORMED_SCALE)
    except IsfError as error:
        if error.where != "scan":
            raise
        moves = error.code is ErrorCode.SCAN_SHIFTED and align != "fit"
        advice = "--align fit moves the scan onto the part" if moves else error.advice
        raise IsfError(error.code, error.what, where=str(bench.scan), advice=advice) from error
    known = replace(
        known, source=f"scan {bench.scan.name} {'out of' if released else 'in'} the clamp, {formed.contours_of}"
    )
    _tell(known, bench.scan)
    release = _release_words(found, bench.release_of)
    terminal.say(f"formed: {formed.contours_of}\nscanned: {release}")
    if align == "fit":
        shift = ", ".join(f"{1e3 * value:.2f}" for value in found.moved)
        terminal.say(f"moved by ({shift}) mm and turned by {np.degrees(found.turned):.2f} deg to lie on the part")
    for remark in formed.remarks:
        terminal.warn(remark)
    told = {
        "scan": str(bench.scan),
        "points": len(found.points),
        "contours": formed.contours_of,
        "state": "released" if released else "clamped",
        "release": _release_numbers(found, bench.release_of),
        "align": align,
        "moved": {"shift_mm": (1e3 * found.moved).tolist(), "angle_deg": float(np.degrees(found.turned))},
        "remarks": list(formed.remarks),
    }
    _keep(known, output, told, as_json=as_json)


def _release_words(found: BenchScan, run: Path | None) -> str:
    if not found.released:
        return "in the clamp"
    if found.movement is None:
        return "out of the clamp: what the part moved by when it was released counts as springback, and is corrected"
    mean, largest = (1e3 * value for value in _movement(found))
    return (
        f"out of the clamp: the movement by release of {run} was taken out ({mean:.2f} mm mean, {largest:.2f} mm "
        "largest, the fit included); corrected is the part as it was in the clamp"
    )


def _release_numbers(found: BenchScan, run: Path | None) -> dict[str, Any] | None:
    if not found.released:
        return None
    if found.movement is None:
        return {"treated": "corrected as springback"}
    mean, largest = _movement(found)
    return {"treated": "taken out", "run": str(run), "mean_abs_mm": 1e3 * mean, "max_abs_mm": 1e3 * largest}


def _movement(found: BenchScan) -> tuple[float, float]:
    assert found.movement is not None  # seen by the callers
    moved = np.abs(found.movement.z[np.isfinite(found.movement.z)])
    return float(moved.mean()), float(moved.max())


def is_job(part: Path) -> bool:
    """True when ``part`` is a job file, by its name."""
    return part.suffix.lower() in (".yaml", ".yml")


def learn_surfaces(runs: list[Path], output: Path, *, as_json: bool) -> None:
    """Learn accuracy surfaces from ``runs`` of different parts on top of ``output`` when it exists, and write it.

    Raises
    ------
    IsfError : BAG_UNREADABLE, LEARNING_UNUSABLE
    """
    known = formed_parts.load(output) if output.exists() else None
    conditions = known.conditions if known else None
    parts = list(known.parts) if known else []
    for run in runs:
        record = read_bag(run)
        part, own = _formed_part(record, str(run))
        if conditions and (other := own.difference(conditions)):
            raise IsfError(
                ErrorCode.LEARNING_UNUSABLE,
                f"was formed under other conditions than the others: {other}",
                where=str(run),
                advice="learn from it in a file of its own: -o FILE",
            )
        conditions = own
        parts.append(part)
        terminal.say(f"{run}: {record.job_name}, deviation {1e3 * part.rms(part.deviation):.2f} mm (rms)")
    if conditions is None:
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, "no run was given", advice="isf learn RUN... --surfaces -o FILE")
    with terminal.console.status("predicting every part from the others"):
        formed = with_held_out(FormedParts(conditions, tuple(parts)))
    formed_parts.save(formed, output)
    rows = [
        {"job": part.name, "thickness_mm": 1e3 * part.thickness, "rms_mm": 1e3 * part.rms(part.deviation)}
        | {"held_out_rms_mm": 1e3 * part.left}
        for part in formed.parts
    ]
    if as_json:
        terminal.print_json(
            {"file": str(output), "parts": rows, "shapes": len(formed.shapes)}
            | {"held_out_rms_mm": 1e3 * formed.uncertainty}
        )
    for row in rows:
        left = f"{row['rms_mm']:.2f} -> {row['held_out_rms_mm']:.2f} mm (rms)"
        terminal.say(f"{row['job']}, predicted from the other shapes: {left}")
    terminal.say(
        f"learned {output} from {len(parts)} parts of {len(formed.shapes)} shapes, right to "
        f"{1e3 * formed.uncertainty:.2f} mm (rms) on shapes held out: name it in the job of another part as "
        "part.accuracy_surfaces"
    )


def _formed_part(record: PartRecord, where: str) -> tuple[FormedPart, Conditions]:
    """Places and deviation of the part of ``record``; raises IsfError LEARNING_UNUSABLE when it is of no use."""
    advice = "learn from whole parts with a scan; isf record records scan and part/target"
    if record.scan is None or record.target is None:
        what = "holds no scan of the finished part, or no target"
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, what, where=where, advice=advice)
    if (failure := record.failure()) is not None:
        what = f"is no complete part: {failure[1]}"
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, what, where=where, advice=advice)
    job = record.job()
    own = Conditions.of(job, record.correction, record.nominal)
    if own.process not in ("SPIF", "DSIF") or own.correction not in formed_parts.PLANNED_METHODS:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            f"is a part of process {own.process} with springback method {own.correction}",
            where=where,
            advice=f"learn from SPIF or DSIF, with method {', '.join(formed_parts.PLANNED_METHODS)}",
        )
    if job.accuracy_surfaces is not None:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            "was itself formed with accuracy surfaces: its deviation is what they left",
            where=where,
            advice="learn from parts formed without part.accuracy_surfaces",
        )
    radius, thickness = job.tool_1.ball_radius, job.sheet.thickness
    return formed_part(record.job_name, record.target, record.scan, radius, thickness), own


@dataclass(frozen=True)
class _Formed:
    """A part as it was formed: contours as planned, their corrections, target and stages; ``contours_of`` says from
    where, for people."""

    name: str
    job_file: JobFile
    nominal: Sequence[Contour]
    corrections: Sequence[ContourCorrection]
    target: HeightMap
    preforms: Sequence[HeightMap]
    shapes: dict[int, FormedShape]
    contours_of: str = ""
    remarks: tuple[str, ...] = ()


def _formed_by_run(run: Path, base: Path | None) -> _Formed:
    record = read_bag(run)
    if record.target is None:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            "holds no target",
            where=str(run),
            advice="record part/target; isf record does; or name the job of the part in place of the run",
        )
    corrected = f"corrected by method {record.correction}" if record.corrects else "without a correction"
    return _recorded(record, record.target, base, f"with the contours of {run}, {corrected}")


def _recorded(record: PartRecord, target: HeightMap, base: Path | None, how: str = "") -> _Formed:
    """Of a ``record`` with its ``target``; ``how`` it was formed, for people."""
    job_file = recorded_job(record, base)
    shapes = _shapes(record, job_file)
    planned = record.nominal, record.corrections
    return _Formed(record.job_name, job_file, *planned, target, record.preforms, shapes, how)


def _formed_by_job(path: Path, *, as_planned: bool) -> _Formed:
    """With the contours that ``isf plan JOB --export`` writes, or as they are planned."""
    job_file = load_job(path)
    made = plan(job_file)
    exported = uncorrected(made, job_file) if as_planned else corrected_ahead(made, job_file)
    corrections = [
        ContourCorrection(made.plan_id, nominal.index, exported.method, sent.contact - nominal.contact, np.empty(0))
        for nominal, sent in zip(made.contours, exported.plan.contours, strict=True)
    ]
    how = f"corrected by method {exported.method} as its exports are" if exported.corrected else "as it was planned"
    remarks: tuple[str, ...] = ()
    if not exported.corrected and exported.method != "none" and not as_planned:
        remarks = (
            f"method {exported.method} of the job corrects while a part is formed: taken is that this one was formed "
            "as planned, from an export; where the cell formed it, name its run or bag in place of the job",
        )
    return _Formed(
        job_file.job.name,
        job_file,
        made.contours,
        corrections,
        made.target,
        made.preforms,
        {},
        f"from {path}, {how}",
        remarks,
    )


def learn_record(record: PartRecord, base: Path | None, known: Learned | None = None) -> Learned:
    """Knowledge after the part of ``record``; ``base`` as in :func:`recorded_job`.

    Raises IsfError LEARNING_UNUSABLE when it is not whole, and what :func:`recorded_job` raises.
    """
    if record.scan is None or record.target is None:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            "holds no scan of the finished part, or no target",
            where=record.job_name,
            advice="record scan and part/target; isf record does",
        )
    formed = _recorded(record, record.target, base)
    # without a model's correction a shallow part may have sprung back altogether
    least = ANY_SCALE if record.correction in UNMODELLED else FORMED_SCALE
    return replace(_learned(formed, record.scan.points(), known, least_scale=least), source=record.plant)


def _learned(
    formed: _Formed, points: Array, known: Learned | None, *, clamped: bool = True, least_scale: float
) -> Learned:
    job_file, nominal = formed.job_file, formed.nominal
    return learn_part(
        nominal,
        formed.corrections,
        points,
        formed.target,
        job_file.rig.clamp.size,
        forming_radius(job_file, nominal[0].forming_tool if nominal else 1),
        formed.name,
        known,
        formed.shapes,
        formed.preforms,
        clamped=clamped,
        least_scale=least_scale,
    )


def _shapes(record: PartRecord, job_file: JobFile) -> dict[int, FormedShape]:
    """What the scans between the contours of ``record`` show, after the contours of their index."""
    memory = ScanMemory(job_file)
    assert record.target is not None  # seen by the caller
    memory.set_target(record.target, record.preforms)
    contours = {contour.index: contour for contour in record.nominal if contour.forming_tool == 1}
    taken = [(scan.index, memory.take(scan.points(), contours.get(scan.index), scan.index)) for scan in record.scans]
    return {index: shape for index, shape in taken if shape is not None}
