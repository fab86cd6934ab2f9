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
from isf_springback.lift_feedback import reading_of
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
        corrector.set_target(part.target, part.preforms)
    corrected = {contour.index: contour for contour in part.corrected}
    results = {result.index: result for result in part.results}
    found = []
    for k, contour in enumerate(part.nominal):
        found.append(corrector.correct(contour))
        result, formed = results.get(contour.index), corrected.get(contour.index)
        if result is None or formed is None:
            break
        corrector.add_result(formed, result)
        lift, scan = lift_after(run, k), scan_after(run, job_file, k)
        if lift is not None:
            corrector.add_lift(reading_of(lift[1]), contour.index)
        if scan is not None:
            corrector.add_scan(scan[1], contour.index)
        if progress is not None:
            progress(k + 1, len(part.nominal))
    return tuple(found)


Stamped = tuple[float, Array]
"""Stamp, s, and (P, 3) m of a scan or (K, 4) m and N of a tool lift."""


def lift_after(run: RecordedRun, place: int) -> Stamped | None:
    """The tool lift made after the contour at ``place`` of the record; None where the tool was not lifted."""
    return _first(run.lifts, *_pause_after(run, place))


def lifted_after(run: RecordedRun) -> frozenset[int]:
    """Indices of the contours after which the tool was lifted."""
    return frozenset(contour.index for k, contour in enumerate(run.part.nominal) if lift_after(run, k) is not None)


def scan_after(run: RecordedRun, job_file: JobFile, place: int) -> Stamped | None:
    """The scan due after the contour at ``place`` of the record, as far as it is in it: scans are made at other times,
    too."""
    contour = run.part.nominal[place]
    return _first(run.scans, *_pause_after(run, place)) if scan_due(job_file, contour.index, contour.count) else None


def _pause_after(run: RecordedRun, place: int) -> tuple[float, float]:
    """s, end of the contour at ``place`` of the record and start of the next; nothing lies between them where it was
    not formed."""
    nominal, results = run.part.nominal, run.result_of
    if nominal[place].index not in results:
        return float("inf"), 0.0
    following = nominal[place + 1].index if place + 1 < len(nominal) else -1
    return results[nominal[place].index].end, results[following].start if following in results else float("inf")


def _first(items: tuple[Stamped, ...], begin: float, end: float) -> Stamped | None:
    """The first of ``items`` that was made from ``begin`` to ``end`` s."""
    for stamp, values in items:
        if begin - STAMP_TOLERANCE <= stamp <= end:
            return stamp, values
    return None
