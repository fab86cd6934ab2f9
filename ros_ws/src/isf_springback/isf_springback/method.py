"""Correction methods by name, and how a correction is applied to a contour.

A method is asked once per contour, in the order of the plan::

    correction = method.correct(contour)
    corrected = apply(contour, correction)      # formed by the machine
    method.learn(corrected, result)             # what was measured meanwhile
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, correction_refusal

from isf_springback.analytic import AnalyticCorrection
from isf_springback.continuity import Continuity, limits_of
from isf_springback.fusion import FusedCorrection
from isf_springback.learned import learned, learned_map
from isf_springback.mpc import mpc_tpif, mpc_two_directional, mpc_vertical
from isf_springback.sheet_load import push_sign


class CorrectionMethod(Protocol):
    """Something that corrects every contour before it is formed."""

    name: str

    def correct(self, contour: Contour) -> ContourCorrection:
        """Correction of the next contour; raises IsfError CONTOUR_REJECTED only."""
        ...

    def learn(self, contour: Contour, result: ContourResult) -> None:
        """Take what was measured while ``contour`` (as corrected) was formed; never raises."""
        ...

    def follow(self, contour: Contour, correction: ContourCorrection) -> None:
        """Take note that another method corrected ``contour``, to take over later without a jump.

        Called in place of :meth:`correct`, for every contour in order, each followed by :meth:`learn`.
        """
        ...


class NoCorrection:
    """Method "none": contours pass unchanged; after a change of method the old correction fades out."""

    name = "none"

    def __init__(self, job_file: JobFile) -> None:
        self._job_file = job_file
        self._continuity = Continuity()

    def correct(self, contour: Contour) -> ContourCorrection:
        """Zero, or what the change limit leaves of another method's correction."""
        started = time.perf_counter()
        contour.validate()
        self._continuity.advance(contour)
        limits = limits_of(self._job_file, contour.forming_tool)
        limited = self._continuity.apply_limits(contour, np.zeros(len(contour)), limits)
        offset = np.zeros((len(contour), 3))
        offset[:, 2] = push_sign(contour) * limited.value
        return ContourCorrection(
            plan_id=contour.plan_id,
            index=contour.index,
            method=self.name,
            offset=offset,
            springback=np.empty(0),
            saturated=limited.saturated,
            solve_time=time.perf_counter() - started,
        )

    def learn(self, contour: Contour, result: ContourResult) -> None:
        """Nothing to learn."""

    def follow(self, contour: Contour, correction: ContourCorrection) -> None:
        """Remember ``correction``, to be faded out."""
        self._continuity.advance(contour)
        self._continuity.remember(contour, push_sign(contour) * np.asarray(correction.offset)[:, 2])


def _elastic(job_file: JobFile) -> CorrectionMethod:
    from isf_springback.elastic import ElasticCorrection  # numba and its kernels: only who uses them waits

    return ElasticCorrection(job_file)


METHODS: dict[str, Callable[[JobFile], CorrectionMethod]] = {
    NoCorrection.name: NoCorrection,
    AnalyticCorrection.name: AnalyticCorrection,
    "elastic": _elastic,
    FusedCorrection.name: FusedCorrection,
    "learned": learned,
    "learned_map": learned_map,
    "mpc_vertical": mpc_vertical,
    "mpc_two_directional": mpc_two_directional,
    "mpc_tpif": mpc_tpif,
}
"""Methods by name; a new method is a class with the three functions of :class:`CorrectionMethod`, entered here."""


def check_name(name: str) -> None:
    """Raise IsfError METHOD_UNKNOWN, with the names that exist, when there is no method ``name``."""
    if name not in METHODS:
        raise IsfError(
            ErrorCode.METHOD_UNKNOWN,
            f"there is no springback method '{name}'",
            where="springback.method",
            advice=f"known: {', '.join(sorted(METHODS))}",
        )


NEEDS_SCANS = ("mpc_vertical", "mpc_two_directional", "mpc_tpif")
"""Methods that correct nothing without scans between contours."""


def check_method(name: str, job_file: JobFile) -> None:
    """Raise IsfError METHOD_UNKNOWN as :func:`check_name`, FILE_FIELD when the job lacks the scans the method needs.

    FILE_FIELD too when the job's process cannot be corrected.
    """
    check_name(name)
    if refusal := correction_refusal(job_file.job.process, name):
        raise IsfError(ErrorCode.FILE_FIELD, refusal, where="springback method", advice="form it with the method none")
    if name in NEEDS_SCANS and job_file.job.springback.scan_every == 0:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"the method {name} corrects from scans, and the job makes none",
            where="springback.scan_every",
            advice="write 'scan_every: 1' in the section springback, or choose another method",
        )


def make_method(name: str, job_file: JobFile) -> CorrectionMethod:
    """A fresh method for one part; raises IsfError as :func:`check_method`."""
    check_method(name, job_file)
    return METHODS[name](job_file)


def apply(contour: Contour, correction: ContourCorrection) -> Contour:
    """The contour as it is to be formed: contact and both tips moved alike, so the gap of the tools stays.

    Raises
    ------
    IsfError : CONTOUR_OUT_OF_ORDER (the correction belongs to another contour), CORRECTION_FAILED (wrong number
        of points, not finite)
    """
    if (correction.plan_id, correction.index) != (contour.plan_id, contour.index):
        raise IsfError(
            ErrorCode.CONTOUR_OUT_OF_ORDER,
            f"the correction belongs to {contour_label(correction.index)} of plan {correction.plan_id}",
            where=f"{contour_label(contour.index)} of plan {contour.plan_id}",
        )
    if correction.offset.shape != (len(contour), 3) or not np.isfinite(correction.offset).all():
        raise IsfError(
            ErrorCode.CORRECTION_FAILED,
            f"the offset of shape {correction.offset.shape} is not {len(contour)} finite points",
            where=contour_label(contour.index),
        )
    return contour.shifted(correction.offset)
