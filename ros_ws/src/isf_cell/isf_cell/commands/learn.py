"""``isf learn``: corrections for the next part from the records of parts formed before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.record import PartRecord
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_springback.estimators import learning
from isf_springback.estimators.learning import Learned, learn_part
from isf_springback.loop_path import forming_radius

from isf_cell.commands import terminal


def learn_runs(runs: list[Path], output: Path, base: Path | None, *, as_json: bool) -> None:
    """Learn from ``runs`` (folders of runs or bags, oldest first) on top of ``output`` when it exists, and write it.

    ``base`` : folder that the paths in the recorded jobs refer to (rig and material files of one's own)

    Raises
    ------
    IsfError : BAG_UNREADABLE, LEARNING_UNUSABLE, codes of scan processing
    """
    known = learning.load(output) if output.exists() else None
    for run in runs:
        known = learn_record(read_bag(run), base or Path.cwd(), known)
        mean, largest = 1e3 * known.history[-1]
        terminal.say(
            f"{run}: part {known.parts} of {known.job}, error of wall and floor {mean:.2f} mm mean, {largest:.2f} mm "
            "largest"
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
            }
        )
    terminal.say(f"learned {output}: name it in the job as springback.learning, with method learned")


def learn_record(record: PartRecord, base: Path, known: Learned | None = None) -> Learned:
    """Knowledge after the part of ``record``; raises IsfError LEARNING_UNUSABLE when it is not whole."""
    if record.scan is None or record.target is None:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            "holds no scan of the finished part, or no target",
            where=record.job_name,
            advice="record scan and part/target; isf record does",
        )
    job_file = JobFile(record.job_text, base, record.job_name)
    return learn_part(
        record.nominal,
        record.corrections,
        record.scan.points(),
        record.target,
        job_file.rig.clamp.size,
        forming_radius(job_file, record.nominal[0].forming_tool if record.nominal else 1),
        record.job_name,
        known,
    )
