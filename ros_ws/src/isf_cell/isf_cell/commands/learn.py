"""``isf learn``: corrections for the next part, or for other parts, from the records of parts formed before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.record import PartRecord
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner.accuracy import formed_parts
from isf_planner.accuracy.formed_parts import Conditions, FormedPart, FormedParts, formed_part
from isf_planner.accuracy.surfaces import with_held_out
from isf_springback.estimators import learning
from isf_springback.estimators.learning import Learned, learn_part
from isf_springback.loop_path import forming_radius
from isf_springback.scan import FormedShape
from isf_springback.scan.feedback import ScanMemory

from isf_cell.commands import terminal
from isf_cell.replay.recorded_run import recorded_job


def learn_runs(runs: list[Path], output: Path, base: Path | None, *, as_json: bool) -> None:
    """Learn from ``runs`` (folders of runs or bags, oldest first) on top of ``output`` when it exists, and write it.

    ``base`` : folder that the paths in the recorded jobs refer to (rig and material files of one's own), None: the
    recorded one of each

    Raises
    ------
    IsfError : BAG_UNREADABLE, LEARNING_UNUSABLE, codes of a job, codes of scan processing
    """
    known = learning.load(output) if output.exists() else None
    for run in runs:
        known = learn_record(read_bag(run), base, known)
        mean, largest = 1e3 * known.history[-1]
        terminal.say(
            f"{run}: part {known.parts} of {known.job}, error of wall and floor {mean:.2f} mm mean, {largest:.2f} mm "
            f"largest; {known.scanned or 'no'} of {known.contours} contours scanned"
        )
    if known is None:
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, "no run was given", advice="isf learn RUN... -o FILE")
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
        )
    terminal.say(f"learned {output}: name it in the job as springback.learning, with method learned")


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
    job_file = recorded_job(record, base)
    return learn_part(
        record.nominal,
        record.corrections,
        record.scan.points(),
        record.target,
        job_file.rig.clamp.size,
        forming_radius(job_file, record.nominal[0].forming_tool if record.nominal else 1),
        record.job_name,
        known,
        _shapes(record, job_file),
        record.preforms,
    )


def _shapes(record: PartRecord, job_file: JobFile) -> dict[int, FormedShape]:
    """What the scans between the contours of ``record`` show, after the contours of their index."""
    memory = ScanMemory(job_file)
    assert record.target is not None  # seen by the caller
    memory.set_target(record.target, record.preforms)
    contours = {contour.index: contour for contour in record.nominal if contour.forming_tool == 1}
    taken = [(scan.index, memory.take(scan.points(), contours.get(scan.index), scan.index)) for scan in record.scans]
    return {index: shape for index, shape in taken if shape is not None}
