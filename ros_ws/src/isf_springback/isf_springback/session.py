"""One part after the other as the springback node sees it, free of ROS: job, contours, results, tool lifts and scans in
any order.

A contour is corrected when its job is known, the result of the contour before it is there, and the lift and the scan
made in between when they are due; or when waiting for them took too long. A change of method takes effect at the next
contour: the new method is given all that happened so far, so that it continues without a jump.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError, coded
from isf_core.files.job import JobFile, springback_method
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_springback.contour_record import ContourRecord, read_records, read_target, write_target
from isf_springback.corrector import Corrector, apply
from isf_springback.estimators.estimator import NoCorrection
from isf_springback.lift_feedback import lift_awaited, reading_of
from isf_springback.methods import check_method, check_name, make_corrector
from isf_springback.scan.feedback import scan_awaited

_log = logging.getLogger(__name__)

STAMP_TOLERANCE = 1e-6
"""s by which the stamp of a scan may lie before the end of the contour it was made after (rounding)."""


@dataclass(frozen=True)
class Outcome:
    """A contour that was dealt with; ``corrected`` is None when it was refused, ``correction`` then has the code."""

    correction: ContourCorrection
    corrected: Contour | None


class CorrectionSession:
    """State of the node; ``timeout`` s of ``clock`` is waited for a job or a result."""

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._timeout = timeout
        self._clock = clock
        self._choice = ""
        self._job: JobFile | None = None
        self._job_method = ""
        self._job_plan = ""
        self._waiting: Contour | None = None
        self._since = 0.0
        self._history: list[ContourRecord] = []
        self._corrector: Corrector | None = None
        self._declined: IsfError | None = None
        self._wanted: tuple[HeightMap, tuple[HeightMap, ...]] | None = None
        self._wanted_written = False
        self._lift: tuple[float, Array] | None = None
        self._scan: tuple[float, Array] | None = None

    @property
    def method_name(self) -> str:
        """Method for the next contour: the one chosen, else the job's; "" while no job is known."""
        if self._job is None or not self._choice:
            return self._choice or self._job_method
        return springback_method(self._job.job, self._choice)

    def choose(self, name: str) -> None:
        """Use method ``name`` from the next contour on ("": the job's); raises IsfError METHOD_UNKNOWN.

        Whether the job has the scans that it needs is seen at the contour: a run chooses before it tells its job.
        """
        if name:
            check_name(name)
        self._choice = name

    def set_job(self, job_file: JobFile, plan_id: str = "", method: str = "") -> None:
        """The job of plan ``plan_id`` ("": of any plan), with the method of the run when it is not the job's."""
        self._job = job_file
        self._job_plan = plan_id
        self._job_method = springback_method(job_file.job, method)

    def add_contour(self, contour: Contour) -> None:
        """A contour to be corrected; replaces one that still waits."""
        self._waiting = contour
        self._since = self._clock()

    def add_result(self, result: ContourResult) -> None:
        """What happened to a corrected contour."""
        for formed in reversed(self._history):
            if (formed.correction.plan_id, formed.correction.index) == (result.plan_id, result.index):
                if formed.result is None and self._corrector is not None:
                    self._corrector.add_result(formed.corrected, result)
                formed.result, formed.written = result, False
                self._assign_lift()
                self._assign_scan()
                return

    def set_target(self, target: HeightMap, preforms: Sequence[HeightMap] = ()) -> None:
        """The shape that is wanted, and those that the stages before the last end with, on the same grid."""
        self._wanted, self._wanted_written = (target, tuple(preforms)), False
        if self._corrector is not None:
            self._corrector.set_target(target, preforms)

    def add_lift(self, rows: Array, time_stamp: float) -> None:
        """Rows (K, 4) of a tool lift, see :func:`isf_springback.lift_feedback.reading_of`, stamped as scans are."""
        self._lift = (time_stamp, rows)
        self._assign_lift()

    def add_scan(self, points: Array, time_stamp: float) -> None:
        """Points (P, 3) m of the formed sheet, measured at ``time_stamp`` s of the clock of the results."""
        self._scan = (time_stamp, points)
        self._assign_scan()

    def _assign_lift(self) -> None:
        """Hand the newest lift to the contour it was made after."""
        if self._lift is None or not self._history:
            return
        last = self._history[-1]
        if last.result is None or last.lift is not None or self._lift[0] < last.result.end - STAMP_TOLERANCE:
            return
        last.lift, self._lift, last.written = self._lift[1], None, False
        if self._corrector is not None:
            self._corrector.add_lift(reading_of(last.lift), last.nominal.index)

    def _assign_scan(self) -> None:
        """Hand the newest scan to the contour it was made after; an older one (latched, another part) waits in vain."""
        if self._scan is None or not self._history:
            return
        last = self._history[-1]
        if last.result is None or last.scan is not None or self._scan[0] < last.result.end - STAMP_TOLERANCE:
            return
        last.scan, self._scan, last.written = self._scan[1], None, False
        if self._corrector is not None:
            self._corrector.add_scan(last.scan, last.nominal.index)

    @property
    def complete(self) -> bool:
        """True when all that is to come after the last contour has come."""
        if not self._history:
            return True
        last = self._history[-1]
        index = last.nominal.index + 1
        return last.result is not None and not self._lift_lacks(index) and not self._scan_lacks(index)

    def save(self, folder: Path) -> None:
        """Write what has come since it was saved last; raises IsfError FILE_NOT_WRITABLE."""
        if self._wanted is not None and not self._wanted_written:
            write_target(*self._wanted, folder)
            self._wanted_written = True
        for record in self._history:
            if not record.written:
                record.write(folder)

    def load(self, folder: Path) -> None:
        """Go on after the contours that were saved in ``folder``; with the next contour its method is given all of them
        again.

        Raises
        ------
        IsfError : FILE_NOT_FOUND, CHECKPOINT_UNUSABLE
        """
        history, wanted = read_records(folder), read_target(folder)
        self.forget()
        self._history = history
        if wanted is not None:
            self._wanted, self._wanted_written = wanted, True

    def forget(self) -> None:
        """The next contour is the first of a part, whatever was formed or loaded before."""
        self._history, self._corrector, self._waiting, self._lift, self._scan = [], None, None, None, None

    def drop(self) -> None:
        """Forget a contour that waits."""
        self._waiting = None

    def advance(self) -> Outcome | None:
        """Correct the waiting contour when its time has come."""
        contour = self._waiting
        if contour is None:
            return None
        late = self._clock() - self._since >= self._timeout
        has_job = self._job is not None and self._job_plan in ("", contour.plan_id)
        here = self._result_is_here(contour) and self._lift_is_here(contour) and self._scan_is_here(contour)
        if not late and not (has_job and here):
            return None
        self._waiting = None
        try:
            if not has_job:
                raise IsfError(
                    ErrorCode.CORRECTION_FAILED,
                    f"no job of plan {contour.plan_id} within {self._timeout:g} s",
                    where=contour_label(contour.index),
                    advice="the executive publishes part/info before the first contour; or set the parameter 'job'",
                )
            corrector = self._corrector_for(contour)
            correction = self._with_missing(contour, corrector.correct(contour))
            corrected = apply(contour, correction, support_stays=corrector.support_stays)
        except Exception as fault:  # a method may be of another package; whoever waits for the contour learns of it
            if not isinstance(fault, IsfError):
                _log.exception("%s: method '%s' failed", contour_label(contour.index), self.method_name)
            error = coded(fault, where=contour_label(contour.index), advice=f"a fault of method '{self.method_name}'")
            return Outcome(_refusal(contour, self.method_name, error), None)
        self._history = [f for f in self._history if f.nominal.index != contour.index]
        self._history.append(ContourRecord(contour, correction, corrected))
        return Outcome(correction, corrected)

    def _result_is_here(self, contour: Contour) -> bool:
        """True when the result of the contour before is known, or that contour was not corrected here."""
        if not self._history or not self._follows(contour):
            return True
        last = self._history[-1]
        return last.nominal.index != contour.index - 1 or last.result is not None

    def _scan_is_here(self, contour: Contour) -> bool:
        """True unless a scan was announced by the job for this contour and the method would use it."""
        return not self._is_next(contour) or not self._scan_lacks(contour.index)

    def _lift_is_here(self, contour: Contour) -> bool:
        """True unless a tool lift was announced by the job for this contour and the method would use it."""
        return not self._is_next(contour) or not self._lift_lacks(contour.index)

    def _is_next(self, contour: Contour) -> bool:
        """True for the contour after the last one of the part in hand."""
        return bool(self._history) and self._follows(contour) and self._history[-1].nominal.index == contour.index - 1

    def _scan_lacks(self, index: int) -> bool:
        wanted = self._job is not None and scan_awaited(self._job, index)
        return wanted and self._history[-1].scan is None and self._corrector is not None and self._corrector.uses_scans

    def _lift_lacks(self, index: int) -> bool:
        wanted = self._job is not None and lift_awaited(self._job, index, self._job_method)
        return wanted and self._history[-1].lift is None and self._corrector is not None and self._corrector.uses_lifts

    def _with_missing(self, contour: Contour, correction: ContourCorrection) -> ContourCorrection:
        """The correction with LIFT_MISSING or SCAN_MISSING when its lift or scan never came, or why a change of method
        was declined."""
        if correction.code:
            return correction
        if self._declined is not None:
            why = f"{self._declined.message}; goes on with {correction.method}"
            return replace(correction, code=int(self._declined.code), message=why)
        if not self._lift_is_here(contour):
            return _with(
                correction,
                ErrorCode.LIFT_MISSING,
                f"no tool lift within {self._timeout:g} s; goes on without",
                "check that the cell serves the action lift_tool, or set springback.lift_every to 0",
            )
        if self._scan_is_here(contour):
            return correction
        return _with(
            correction,
            ErrorCode.SCAN_MISSING,
            f"no scan within {self._timeout:g} s; goes on without",
            "check the scanner, or set springback.scan_every to 0",
        )

    def _follows(self, contour: Contour) -> bool:
        """True when ``contour`` belongs to the part in hand; contour 0 is a new part unless it is asked for again."""
        last = self._history[-1].nominal
        return last.plan_id == contour.plan_id and (contour.index > 0 or last.index == 0)

    def _corrector_for(self, contour: Contour) -> Corrector:
        assert self._job is not None  # checked by the caller
        if self._history and not self._follows(contour):
            self._history = []
            self._corrector = None
        if not self._history:
            self._corrector = None
            self._lift = self._scan = None  # of an earlier part
        self._declined = None
        if self._corrector is None and self._history:
            self._corrector = self._taken_up(contour)
        if self._corrector is None or self._corrector.name != self.method_name:
            try:
                check_method(self.method_name, self._job)
                corrector = self._made(self.method_name)
                for record in self._history:
                    corrector.follow(record.nominal, record.correction)
                    _tell(corrector, record)
            except IsfError as error:
                if self._corrector is None:
                    raise
                self._declined = error  # half a part is formed: it goes on with the method it has
                return self._corrector
            self._corrector = corrector
        return self._corrector

    def _made(self, method: str) -> Corrector:
        assert self._job is not None  # checked by whoever corrects
        corrector = make_corrector(method, self._job)
        if self._wanted is not None:
            corrector.set_target(*self._wanted)
        return corrector

    def _taken_up(self, contour: Contour) -> Corrector:
        """The corrector in the state in which it was after the contours that were loaded: it corrects them again.

        Raises
        ------
        IsfError : CHECKPOINT_UNUSABLE, it corrects them otherwise, or they are not those before ``contour``
        """
        indices = [record.nominal.index for record in self._history]
        if indices != list(range(indices[0], contour.index)):
            raise IsfError(
                ErrorCode.CHECKPOINT_UNUSABLE,
                f"the contours that are kept are not those up to {contour_label(contour.index - 1)}",
                advice="form the part again, on a fresh blank",
            )
        method = self._history[-1].correction.method
        own = len(self._history)
        while own > 0 and self._history[own - 1].correction.method == method:
            own -= 1  # before them another method corrected
        corrector = self._made(method)
        for k, record in enumerate(self._history):
            if k < own or record.correction.code:  # corrected without what came too late: not so again
                corrector.follow(record.nominal, record.correction, predict=k >= own)
            else:
                offset = corrector.correct(record.nominal).offset
                if offset.shape != record.correction.offset.shape or not _same(offset, record.correction.offset):
                    raise IsfError(
                        ErrorCode.CHECKPOINT_UNUSABLE,
                        f"the method '{method}' now gives another correction than when it was formed",
                        where=contour_label(record.nominal.index),
                        advice="what it reads (models, files that the job names) has changed: restore it, or form the "
                        "part again",
                    )
            _tell(corrector, record)
        return corrector


SAME = 1e-6
"""m, largest difference of two corrections that count as the same: another processor may round otherwise."""


def _same(offset: Array, before: Array) -> bool:
    return bool((np.abs(offset - before) <= SAME).all())


def _tell(corrector: Corrector, record: ContourRecord) -> None:
    """What was measured of a contour."""
    if record.result is not None:
        corrector.add_result(record.corrected, record.result)
    if record.lift is not None:
        corrector.add_lift(reading_of(record.lift), record.nominal.index)
    if record.scan is not None:
        corrector.add_scan(record.scan, record.nominal.index)


def _with(correction: ContourCorrection, code: ErrorCode, what: str, advice: str) -> ContourCorrection:
    """``correction`` with the code and text of what was missing."""
    error = IsfError(code, what, where=contour_label(correction.index), advice=advice)
    return replace(correction, code=int(error.code), message=error.message)


def _refusal(contour: Contour, method: str, error: IsfError) -> ContourCorrection:
    """A correction without points that tells why there is none."""
    none = np.empty(0)
    blank = ContourCorrection(contour.plan_id, contour.index, method or NoCorrection.name, np.empty((0, 3)), none)
    return replace(blank, code=int(error.code), message=error.message)
