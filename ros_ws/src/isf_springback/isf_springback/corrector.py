"""The corrector: turns what a method predicts into a correction that every contour can be formed with.

It owns what all methods have in common: the history of the part and the steps from contour to contour, passes over the
floor, the bound by the force of the machine, the limits, the room beside a die, and the message. A method only predicts
(:mod:`isf_springback.estimators.estimator`). Per contour::

    correction = corrector.correct(contour)
    corrected = apply(contour, correction)      # formed by the machine
    corrector.add_result(corrected, result)     # what was measured meanwhile
    corrector.add_lift(reading, index)          # where the job asks for tool lifts
    corrector.add_scan(points, index)           # where the job asks for scans
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Mask

from isf_springback.die_room import within_room
from isf_springback.estimators.estimator import Bounds, Estimator, Prediction
from isf_springback.floor_feedback import FloorFeedback, at_edge
from isf_springback.history import History
from isf_springback.lift_feedback import LiftReading
from isf_springback.limits import (
    NEGLIGIBLE,
    change_per_contour,
    fade_horizontal,
    horizontal_limits,
    limit,
    push_limits,
)
from isf_springback.loop_path import LoopPath
from isf_springback.scan_memory import ScanMemory, contour_over_die
from isf_springback.sheet_load import push_sign
from isf_springback.step_force import StepForce, depth_of, step_remark

DIE_REMARK = "the die leaves no room for more correction where the contour works over it"


@dataclass(frozen=True)
class _Push:
    """Push of one contour: ``asked`` for and ``given`` (N,) m, where a limit changed it, and what to tell of it."""

    asked: Array
    given: Array
    limited: Mask
    over_floor: bool
    remarks: tuple[str, ...]


class Corrector:
    """Corrects one part after the other, contour by contour, by the predictions of one ``estimator``."""

    def __init__(self, estimator: Estimator, job_file: JobFile) -> None:
        self._estimator = estimator
        self._job_file = job_file
        self._history = History(ScanMemory(job_file, over_die=estimator.over_die))
        self._floor = FloorFeedback()
        self._force = StepForce(job_file)

    @property
    def name(self) -> str:
        """Name of the method."""
        return self._estimator.name

    @property
    def uses_lifts(self) -> bool:
        """True when the method learns from tool lifts."""
        return self._estimator.uses_lifts

    @property
    def uses_scans(self) -> bool:
        """True when the method learns from scans."""
        return self._estimator.uses_scans

    def set_target(self, target: HeightMap) -> None:
        """The shape that is wanted, before the first contour."""
        self._history.scans.target = target

    def correct(self, contour: Contour) -> ContourCorrection:
        """Correction of the next contour; never raises for missing or bad measurements.

        Where the method lacks something, the last good correction is kept and the code tells what. CORRECTION_LIMITED:
        the largest correction was reached.

        Raises
        ------
        IsfError : CONTOUR_REJECTED, the contour itself is malformed
        """
        started = time.perf_counter()
        contour.validate()
        fault = self._begin(contour)
        prediction: Prediction | None = None
        if fault is None:
            try:
                prediction = self._estimator.estimate(contour, self._history)
                fault = prediction.fault
            except IsfError as error:
                fault = error
        bounds = self._estimator.bounds(contour, self._history)
        path = LoopPath.of(contour)
        push = self._push(contour, path, prediction, bounds)
        horizontal, limited, far = self._horizontal(contour, path, prediction, bounds)
        offset = np.column_stack([horizontal, push_sign(contour) * push.given])
        limited |= push.limited
        remarks = push.remarks if prediction is None else (*prediction.remarks, *push.remarks)
        if bounds.die is not None:
            offset, held = within_room(bounds.die, contour_over_die(contour), offset)
            limited |= held
            remarks += (DIE_REMARK,) if held.any() else ()
        largest = max(float(np.abs(push.asked).max()), far)
        if fault is None and largest > bounds.largest:
            fault = _too_large(contour, largest, bounds.largest)
        self._add_formed(contour, offset, over_floor=push.over_floor)
        spent = time.perf_counter() - started
        return _message(self.name, contour, prediction, push, offset, limited, fault, remarks, spent)

    def follow(self, contour: Contour, correction: ContourCorrection) -> None:
        """Take note that another method corrected ``contour``, to take over later without a jump.

        Called in place of :meth:`correct`, for every contour in order, each followed by its measurements.
        """
        self._begin(contour)
        before = None if self._history.base is None else self._history.base.contour
        passed = self._floor.push(contour, before, self._history.last_push(contour)) is not None
        self._add_formed(contour, np.asarray(correction.offset, dtype=np.float64), over_floor=passed)

    def add_result(self, contour: Contour, result: ContourResult) -> None:
        """What was measured while ``contour`` (as corrected) was formed; never raises."""
        self._estimator.add_result(contour, result, self._history)
        self._force.add(contour, result)

    def add_lift(self, reading: LiftReading | None, index: int) -> None:
        """What the tool lift after contour ``index`` measured, None when it failed; never raises."""
        if self.uses_lifts:
            self._estimator.add_lift(reading, index)

    def add_scan(self, points: Array, index: int) -> None:
        """Points (P, 3) m of the sheet's upper surface after contour ``index``; never raises."""
        if not self.uses_scans:
            return
        history, formed = self._history, self._history.current
        if formed is not None and formed.contour.forming_tool != 1:
            self._estimator.add_shape(None, history)  # a scan from above does not show what is formed from below
            return
        shape = history.scans.take(points, None if formed is None else formed.contour, index)
        if shape is not None and history.scans.target is not None:
            self._floor.update(shape.surface, history.scans.target)
        self._estimator.add_shape(shape, history)

    # -- inside --------------------------------------------------------------------------------------

    def _begin(self, contour: Contour) -> IsfError | None:
        """Advance to ``contour``; the error when it is out of order."""
        current = self._history.current
        if current is not None and (current.contour.plan_id, current.contour.forming_tool) != (
            contour.plan_id,
            contour.forming_tool,
        ):
            self._floor, self._force = FloorFeedback(), StepForce(self._job_file)
        fault = self._history.advance(contour)
        self._estimator.begin(contour, self._history)
        return fault

    def _add_formed(self, contour: Contour, offset: Array, *, over_floor: bool) -> None:
        self._history.add(contour, offset, over_floor=over_floor)
        if over_floor:
            self._floor.add(contour, push_sign(contour) * offset[:, 2])
        self._estimator.add_formed(contour, offset, self._history)

    def _push(self, contour: Contour, path: LoopPath, prediction: Prediction | None, bounds: Bounds) -> _Push:
        """Push of ``contour``: over a floor what the floor needs, else what the method asks for, within all bounds."""
        history = self._history
        base, last = history.base, history.last_push(contour)
        pressed = self._floor.push(contour, None if base is None else base.contour, last)
        asked = last if prediction is None else self._asked(prediction)
        if pressed is not None:
            asked = pressed
        elif bounds.at_floor:
            asked = at_edge(contour, self._job_file, asked, last)
        # lifted tools jump nowhere; a floor may need far less push than the wall before it
        free = base is None or pressed is not None
        admitted, remarks = self._bounded(contour, asked, last, bounds, forced=pressed is None)
        limits = push_limits(
            self._job_file,
            contour.forming_tool,
            change=bounds.largest if free else change_per_contour(self._job_file),
            largest=bounds.largest,
            smallest=-np.inf if bounds.pulls_back else 0.0,
        )
        start = None if base is None else float(base.push[-1])
        given, limited = limit(admitted, path, limits, last, start)
        limited |= asked - admitted > NEGLIGIBLE
        return _Push(asked, given, limited, pressed is not None, remarks)

    def _asked(self, prediction: Prediction) -> Array:
        if prediction.push is not None:
            return prediction.push
        return np.asarray(self._job_file.job.springback.gain * prediction.springback)

    def _bounded(
        self, contour: Contour, asked: Array, last: Array, bounds: Bounds, *, forced: bool
    ) -> tuple[Array, tuple[str, ...]]:
        """(N,) m, as much of ``asked`` as the method's rise and (where ``forced``) the machine's force allow."""
        rise = bounds.rise if self._history.base is not None else np.inf
        admitted = np.minimum(asked, np.maximum(last, 0.0) + rise)
        if not (bounds.by_force and forced):
            return admitted, ()
        room = self._force.deepest(contour) - depth_of(contour) - float(last.mean())
        if bool((last + room >= admitted).all()):
            return admitted, ()
        admitted = np.minimum(admitted, last + room)
        planned = self._job_file.job.path.incremental_depth
        return admitted, (step_remark(planned + room, planned, -float(admitted.mean())),)

    def _horizontal(
        self, contour: Contour, path: LoopPath, prediction: Prediction | None, bounds: Bounds
    ) -> tuple[Array, Mask, float]:
        """(N, 2) m horizontal offset, where a limit changed it, and the largest value asked for, m.

        Without a prediction the last one is kept; a method without horizontal offsets lets that of another one fade.
        """
        last = self._history.last_offset(contour)[:, :2]
        none = np.zeros(len(contour), dtype=bool)
        if prediction is None:
            return last, none, 0.0
        if prediction.horizontal is None:
            wanted, limited, largest = np.zeros((len(contour), 2)), none, 0.0
        else:
            direction, value = prediction.horizontal.direction, prediction.horizontal.value
            along = np.sum(last * direction, axis=1)
            asked = along if value is None else value
            limits = horizontal_limits(self._job_file, contour.forming_tool, bounds.largest)
            given, limited = limit(asked, path, limits, along)
            wanted, largest = given[:, None] * direction, float(np.abs(asked).max())
        if self._history.base is None:
            return wanted, limited, largest
        faded, far = fade_horizontal(wanted, last, change_per_contour(self._job_file))
        return faded, limited | far, largest


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


def _too_large(contour: Contour, asked: float, largest: float) -> IsfError:
    return IsfError(
        ErrorCode.CORRECTION_LIMITED,
        f"{1e3 * asked:.1f} mm asked for, the largest correction is {1e3 * largest:.1f} mm",
        where=contour_label(contour.index),
        advice="check measured force, scanner and clamp, and the sheet thickness of the job",
    )


def _message(
    method: str,
    contour: Contour,
    prediction: Prediction | None,
    push: _Push,
    offset: Array,
    limited: Mask,
    fault: IsfError | None,
    remarks: tuple[str, ...],
    spent: float,
) -> ContourCorrection:
    """What is published: z up, against the push of the upper tool."""
    said = Prediction(np.empty(0)) if prediction is None else prediction
    up = -push_sign(contour)
    remaining = np.empty(0)
    if len(said.expected_error):
        remaining = said.expected_error
    elif len(said.springback):
        remaining = up * (push.asked - push.given)
    return ContourCorrection(
        plan_id=contour.plan_id,
        index=contour.index,
        method=method,
        offset=offset,
        springback=up * said.springback,
        control_point=said.control_point,
        control_point_springback=up * said.control_point_springback,
        control_point_force=said.control_point_force,
        saturated=limited,
        code=0 if fault is None else int(fault.code),
        message="" if fault is None else fault.message,
        solve_time=spent,
        uncertainty=said.deviation,
        residual=remaining,
        remarks=remarks,
    )
