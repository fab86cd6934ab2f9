"""Recorded results, tool lifts and scans given to a springback method again, contour by contour.

The method decides for itself from the first contour on, and learns what was measured of the part as it was formed. With
the recorded method and job it gives the recorded corrections to the last bit. With others it corrects what was measured
under other corrections: a method that predicts from forces loses little by that, one that reads the error of the shape
sees an error that its own corrections would have changed.
"""

from __future__ import annotations

from collections.abc import Callable

from isf_core.contour import ContourCorrection
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_springback.lift_feedback import lift_due, reading_of
from isf_springback.methods import make_corrector
from isf_springback.scan.feedback import scan_due
from isf_springback.session import STAMP_TOLERANCE

from isf_cell.replay.recorded_run import RecordedRun


def replay_corrections(
    run: RecordedRun, job_file: JobFile, method: str, progress: Callable[[int, int], None] | None = None
) -> tuple[ContourCorrection, ...]:
    """Corrections by ``method`` of ``job_file`` of every recorded contour.

    Raises
    ------
    IsfError : the method cannot serve this job
    """
    part = run.part
    corrector = make_corrector(method, job_file)
    if part.target is not None:
        corrector.set_target(part.target)
    corrected = {contour.index: contour for contour in part.corrected}
    results = {result.index: result for result in part.results}
    found = []
    for k, contour in enumerate(part.nominal):
        found.append(corrector.correct(contour))
        result, formed = results.get(contour.index), corrected.get(contour.index)
        if result is None or formed is None:
            break
        corrector.add_result(formed, result)
        following = part.nominal[k + 1].index if k + 1 < len(part.nominal) else -1
        until = results[following].start if following in results else float("inf")
        if (
            lift_due(job_file, contour.index, contour.count)
            and (rows := _first(run.lifts, result.end, until)) is not None
        ):
            corrector.add_lift(reading_of(rows), contour.index)
        if scan_due(job_file, contour.index, contour.count):
            points = _first(run.scans, result.end, until)
            if points is not None:
                corrector.add_scan(points, contour.index)
        if progress is not None:
            progress(k + 1, len(part.nominal))
    return tuple(found)


def _first(items: tuple[tuple[float, Array], ...], begin: float, end: float) -> Array | None:
    """The first of ``items`` (stamp s, array) that was made from ``begin`` to ``end`` s."""
    for stamp, values in items:
        if begin - STAMP_TOLERANCE <= stamp <= end:
            return values
    return None
