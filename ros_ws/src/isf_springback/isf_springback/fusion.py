"""Method "fused": model forward, shape back, as one estimate with its uncertainty.

Springback of the coming contour = prediction of the model from the measured force + bias of the model, estimated from
the scans (:mod:`isf_springback.bias_field`). The correction is that sum, limited like every other one. Without scans,
or with scans that cannot be used, it is the model alone with the last bias: nothing jumps.

Two biases are kept. The wall is final once the contact has passed (scans of the simulated part and Lu's zone A agree
on this), so that the *wall* bias is read just above the contact. The floor is made by the last contours alone; the
*bottom* bias is read under and inside the tip, and takes over where the remaining depth is less than the height of the
contact above the tip.

A feature formed from below, by the lower tool, is corrected by the model alone: what a scan tells of the wall and floor
of a pocket is not true of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_springback.analytic import AnalyticCorrection, AnalyticOptions
from isf_springback.bias_field import START_DEVIATION, BiasField, carried, first_field, updated
from isf_springback.continuity import MAGNITUDE, forming_radius
from isf_springback.floor_feedback import FloorFeedback, at_edge
from isf_springback.lift_feedback import LiftReading
from isf_springback.loop_path import LoopPath, nearest_points
from isf_springback.offset_memory import VISIBLE, OffsetMemory, limit_signed, push_limits
from isf_springback.scan_memory import ScanMemory
from isf_springback.shape_reading import PLACES, READING_DEVIATION, read_errors
from isf_springback.shape_remarks import shape_remarks
from isf_springback.sheet_edge import held_by_plate
from isf_springback.sheet_load import push_sign
from isf_springback.step_bounds import largest_rise
from isf_springback.step_force import StepForce, depth_of, step_remark

LARGEST_BIAS = 3e-3
"""m; the shape may ask for that much more than the model and no more, and may take back the model's correction
altogether (assumed: more than half of all published springback)."""
DEEPER = 0.2e-3
"""m of more push than on the contour before, beyond which a contour wipes out the traces of that one."""
MADE_BY = 4
"""Contours that make the wall at one place: the ball touches it again and again."""
EDGE_CONTOURS = 2
"""Contours whose scans show the edge of the opening alone where a backing plate is close and holds it; else
:data:`MADE_BY`, since a free edge bends down with each of them."""
RESTLESS = 40.0
"""Contours of drift after a scan that surprised everywhere (assumed): a surprise that comes again is a change of the
process, and is then followed within two scans."""
SURPRISING = 0.25
"""Share of doubtful places from which a scan contradicts the model."""
SLOW_RISE = 0.5
"""Incremental depths by which a correction may grow per contour until a scan has confirmed the model (assumed: what was
formed too deep stays)."""
TOLD_BIAS = 1.5e-3
"""m of disagreement of model and shape that is told."""
MODEL_ALONE = "no scans and no tool lifts (springback.scan_every, lift_every): the correction is the model's alone"
FROM_BELOW = "scans steer the upper tool only: the feature formed from below is corrected by the model"


def steady_model(job_file: JobFile) -> AnalyticCorrection:
    """The model that the job names, with the last force held.

    With the trend of the force in the forecast, model and feedback of the shape chase each other: a larger correction
    raises the force, and the forecast raises the next correction again. On the simulated cone the correction changed
    by 0.17 mm rms from contour to contour with the trend, by 0.05 mm without, and the wall came out better.
    """
    if job_file.job.springback.fused.model == "analytic":
        return AnalyticCorrection(job_file, AnalyticOptions.of(job_file, "hold"))
    from isf_springback.elastic import ElasticCorrection  # numba and its kernels: only who uses them waits

    return ElasticCorrection(job_file, law="hold", axial_only=True)


@dataclass(frozen=True)
class FormedStep:
    """One contour of N points: how it was pushed, and what the model says of it, with the force measured on it once
    that is known; (N,) m each."""

    contour: Contour
    pushed: Array
    model: Array


class FusedCorrection:
    """Corrects contour after contour. State: the model, both biases, the last correction, the newest shape."""

    name = "fused"

    def __init__(self, job_file: JobFile, model: Callable[[JobFile], AnalyticCorrection] = steady_model) -> None:
        self._job_file = job_file
        self._model = model(job_file)
        self._memory = OffsetMemory()
        self._scans = ScanMemory(job_file)
        self._floor = FloorFeedback()
        self._wall: BiasField | None = None
        self._bottom: BiasField | None = None
        self._steps: list[FormedStep] = []
        self._wall_begins = 0
        self._confirmed = False
        self._remarks: tuple[str, ...] = ()
        self._doubtful = 0.0
        self._step_force = StepForce(job_file)
        self._first: tuple[str, int] | None = None

    def take_target(self, target: HeightMap) -> None:
        """The shape that is wanted."""
        self._scans.target = target

    def learn(self, contour: Contour, result: ContourResult) -> None:
        """Forces for the model, and how near they come to the limits of the machine."""
        self._model.learn(contour, result)
        told = self._model.hindsight()
        if told is not None and self._steps and self._steps[-1].contour.index == contour.index:
            self._steps[-1] = replace(self._steps[-1], model=told)
        self._step_force.take(contour, result)

    def feel(self, reading: LiftReading | None, index: int) -> None:
        """A tool lift scales the model; as far as scans have fixed the sum of model and bias, the sum stays."""
        before = [self._model.lifted_share(step.contour.contact) for step in self._steps]
        self._model.feel(reading, index)
        if not self._steps:
            return
        factors = [
            self._model.lifted_share(step.contour.contact) / old for step, old in zip(self._steps, before, strict=True)
        ]
        last = self._steps[-1]
        grown = (factors[-1] - 1.0) * last.model
        self._wall, self._bottom = (_shifted(field, last.contour, grown) for field in (self._wall, self._bottom))
        self._steps = [
            replace(step, model=factor * step.model) for step, factor in zip(self._steps, factors, strict=True)
        ]

    def follow(self, contour: Contour, correction: ContourCorrection) -> None:
        """Take note that another method corrected ``contour``; the model predicts along, to compare with scans."""
        self._advance(contour)
        predicted = self._model.correct(contour)
        self._model.follow(contour, correction)
        self._memory.remember(contour, np.asarray(correction.offset))
        self._step(contour, _along(predicted, contour), np.asarray(correction.offset))

    def see(self, points: Array, index: int) -> None:
        """Update both biases from the shape after contour ``index``; what is wrong is told by the next correction."""
        applied = self._memory.pending
        if applied is not None and applied.contour.forming_tool != 1:
            self._remarks = (FROM_BELOW,)
            return
        shape = self._scans.take(points, None if applied is None else applied.contour, index)
        target = self._scans.target
        if shape is None or applied is None or target is None or not self._steps:
            return
        contour = applied.contour
        self._floor.see(shape.surface, target)
        told = shape_remarks(shape, target, float(contour.forming_tip[:, 2].min()), self._job_file)
        if self._floor.passes(contour):
            self._remarks = (*shape.remarks, *told)
            return
        reading = read_errors(contour, shape, target, forming_radius(self._job_file, contour.forming_tool))
        noise = np.full(len(reading.place), float(np.hypot(READING_DEVIATION, shape.noise)))
        known = self._fields(reading.place)
        surprise = reading.wall - expected_error(self._steps, reading.place)
        edge = EDGE_CONTOURS if held_by_plate(contour, self._job_file) else MADE_BY
        if contour.index - self._wall_begins < edge:
            # Still the edge of the opening: no push makes it better where it stands too high, as it always does a
            # little. Where it lies too deep the coming contours would press it deeper yet.
            surprise = np.where(surprise < 0.0, surprise, np.nan)
            if np.isfinite(surprise).any():
                self._wall, _ = updated(known[0], surprise, noise)
            return
        last = self._steps[-1]
        near = nearest_points(reading.place, contour.forming_tip[:, :2])
        self._wall, doubt_wall = updated(known[0], surprise, noise)
        self._bottom, _ = updated(known[1], reading.bottom - (last.model - last.pushed)[near], noise)
        self._confirmed = True
        self._doubtful = float(doubt_wall.mean())
        self._remarks = (*shape.remarks, *told)

    def correct(self, contour: Contour) -> ContourCorrection:
        """Correction of the next contour; never raises for missing or bad forces and scans.

        Raises
        ------
        IsfError : CONTOUR_REJECTED, the contour itself is malformed
        """
        started = time.perf_counter()
        contour.validate()
        self._advance(contour)
        model = self._model.correct(contour)
        fault = IsfError(ErrorCode(model.code), model.message) if model.code else self._scans.fault_before(contour)
        predicted = _along(model, contour)
        path = LoopPath.of(contour)
        place, disagreement, deviation = self._bias(contour, path)
        bias = np.clip(disagreement, -np.maximum(predicted, LARGEST_BIAS), LARGEST_BIAS)
        sign = push_sign(contour)
        before = self._memory.last(contour)
        if model.code and not len(model.springback):
            wanted = sign * before[:, 2]  # no force: the last good correction
        else:
            wanted = self._job_file.job.springback.gain * (predicted + bias)
        base = self._memory.base
        pressed = self._floor.push(contour, None if base is None else base.contour, sign * before[:, 2])
        wanted = at_edge(contour, self._job_file, wanted, sign * before[:, 2]) if pressed is None else pressed
        rise = change = largest_rise(self._job_file)
        if self._memory.base is None:
            rise = change = MAGNITUDE  # the part begins or the tools have swapped: lifted, they jump nowhere
        elif contour.forming_tool == 1 and self._unconfirmed():
            rise = min(rise, SLOW_RISE * self._job_file.job.path.incremental_depth)
        admitted = np.minimum(wanted, np.maximum(sign * before[:, 2], 0.0) + rise)
        planned = self._job_file.job.path.incremental_depth
        room = self._step_force.deepest(contour) - depth_of(contour) - float(sign * before[:, 2].mean())
        borne = pressed is not None or bool((sign * before[:, 2] + room >= admitted).all())
        if not borne:
            admitted = np.minimum(admitted, sign * before[:, 2] + room)
        free = change if pressed is None else MAGNITUDE  # a floor may need far less push than the wall
        limits = push_limits(self._job_file, contour.forming_tool, change=free)
        value, bound = limit_signed(admitted, path, limits, sign * before[:, 2])
        bound |= wanted - admitted > VISIBLE
        offset = np.zeros((len(contour), 3))
        offset[:, 2] = sign * value
        self._memory.remember(contour, offset)
        if pressed is None:
            self._step(contour, predicted, offset)
        else:
            self._floor.remember(contour, value)
        remarks = [*model.remarks, *self._remarks, *self._alone(contour)]
        if np.abs(disagreement).max() >= TOLD_BIAS:
            followed = "" if np.array_equal(bias, disagreement) else ", which is not followed altogether"
            far = float(disagreement[np.argmax(np.abs(disagreement))])
            remarks.append(f"the shape says {1e3 * far:+.1f} mm springback against the model{followed}")
        if not borne:
            remarks.append(step_remark(planned + room, planned, -float(value.mean())))
        if self._doubtful > SURPRISING:
            remarks.append(f"the last scan surprises at {100 * self._doubtful:.0f} % of the places: believed less")
        if fault is None and np.abs(wanted).max() > MAGNITUDE:
            fault = IsfError(
                ErrorCode.CORRECTION_LIMITED,
                f"{1e3 * float(np.abs(wanted).max()):.1f} mm asked for, the largest correction is "
                f"{1e3 * MAGNITUDE:.1f} mm",
                where=contour_label(contour.index),
                advice="check the measured force, the clamp size and the sheet thickness of the job",
            )
        correction = ContourCorrection(
            plan_id=contour.plan_id,
            index=contour.index,
            method=self.name,
            offset=offset,
            springback=-sign * (predicted + bias),
            control_point=place,
            saturated=bound,
            code=0 if fault is None else int(fault.code),
            message="" if fault is None else fault.message,
            solve_time=time.perf_counter() - started,
            uncertainty=deviation,
            residual=-sign * (wanted - value),
            remarks=tuple(remarks),
        )
        self._model.follow(contour, correction)
        return correction

    # -- inside --------------------------------------------------------------------------------------

    def _alone(self, contour: Contour) -> tuple[str, ...]:
        """A remark with the first contour that is corrected, when nothing will be measured between contours."""
        if self._first is None or self._first[0] != contour.plan_id:
            self._first = (contour.plan_id, contour.index)
        spec = self._job_file.job.springback
        measured = spec.scan_every or spec.lift_every
        return () if measured or self._first[1] != contour.index else (MODEL_ALONE,)

    def _unconfirmed(self) -> bool:
        """True while scans are to come and none has confirmed the model, or the last one contradicts it."""
        if self._job_file.job.springback.scan_every != 1:
            return False  # several contours without a scan: the model is all there is
        return not self._confirmed or self._doubtful > SURPRISING

    def _step(self, contour: Contour, predicted: Array, offset: Array) -> None:
        """Note how ``contour`` is pushed; asking again for a contour replaces it."""
        before = [step for step in self._steps if step.contour.index < contour.index and _same_wall(step, contour)]
        if not before:
            self._wall_begins = contour.index
        pushed = push_sign(contour) * offset[:, 2]
        self._steps = [*before[1 - MADE_BY :], FormedStep(contour, pushed, predicted)]

    def _advance(self, contour: Contour) -> None:
        pending = self._memory.pending
        if pending is not None and pending.contour.plan_id != contour.plan_id:
            self._scans.clear()
            self._forget()
        elif pending is not None and pending.contour.forming_tool != contour.forming_tool:
            self._forget()  # a bias is one of pushing that way
        self._memory.advance(contour)

    def _forget(self) -> None:
        self._wall = self._bottom = None
        self._floor = FloorFeedback()
        self._steps = []
        self._confirmed = False
        self._doubtful = 0.0
        self._step_force = StepForce(self._job_file)
        self._remarks = ()

    def _fields(self, place: Array) -> tuple[BiasField, BiasField]:
        """Both biases at ``place`` (M, 2) m, one contour later than last time."""
        drift = 1.0 + RESTLESS * self._doubtful
        wall = first_field(place) if self._wall is None else carried(self._wall, place, drift)
        bottom = first_field(place) if self._bottom is None else carried(self._bottom, place, drift)
        return wall, bottom

    def _bias(self, contour: Contour, path: LoopPath) -> tuple[Array, Array, Array]:
        """Places (M, 3) m, bias and its standard deviation along the contour (N,), (N,) m."""
        position = path.even_positions(PLACES)
        place = np.column_stack([path.at(contour.contact[:, axis], position) for axis in range(3)])
        wall, bottom = self._fields(place[:, :2])
        share = self._floor_share(contour)
        period = path.length if path.closed else None

        def along(values: Array) -> Array:
            return np.asarray(np.interp(path.position, position, values, period=period))

        bias = (1.0 - share) * along(wall.bias) + share * along(bottom.bias)
        deviation = np.maximum(along(wall.deviation), along(bottom.deviation))
        return place, bias, deviation

    def _floor_share(self, contour: Contour) -> Array:
        """(N,) 0 on the wall .. 1 where the contour makes the floor."""
        target = self._scans.target
        if target is None or self._job_file.job.path.floor_step is not None:
            return np.zeros(len(contour))  # passes over the floor make it
        left = np.abs(contour.forming_tip[:, 2] - float(np.nanmin(target.z)))
        height = forming_radius(self._job_file, contour.forming_tool) * (1.0 - np.cos(np.radians(50.0)))
        return np.asarray(np.clip(1.0 - left / height, 0.0, 1.0))


def _shifted(field: BiasField | None, contour: Contour, grown: Array) -> BiasField | None:
    """``field`` after the model has ``grown`` by (N,) m along ``contour``: less where measured, as it was elsewhere."""
    if field is None:
        return None
    measured = 1.0 - np.clip(field.deviation / START_DEVIATION, 0.0, 1.0) ** 2
    shift = measured * grown[nearest_points(field.place, contour.contact[:, :2])]
    return BiasField(field.place, field.bias - shift, field.covariance)


def expected_error(steps: Sequence[FormedStep], place: Array) -> Array:
    """(M,) m, error of the wall at ``place`` (M, 2) m by the model alone: mean over the contours that made it.

    A contour that went deeper than the one before it by more than :data:`DEEPER` is the first that counts.
    """
    total, count, counts = np.zeros(len(place)), np.zeros(len(place)), np.ones(len(place))
    later: Array | None = None
    for step in reversed(steps):
        near = nearest_points(place, step.contour.forming_tip[:, :2])
        pushed, model = step.pushed[near], step.model[near]
        if later is not None:
            counts = np.where(later > pushed + DEEPER, 0.0, counts)
        total += counts * (model - pushed)
        count += counts
        later = pushed
    return np.asarray(total / count)


def _same_wall(step: FormedStep, contour: Contour) -> bool:
    """True when both contours belong to one feature, stage and forming tool of one plan."""
    known = step.contour
    return (known.plan_id, known.feature, known.stage, known.forming_tool) == (
        contour.plan_id,
        contour.feature,
        contour.stage,
        contour.forming_tool,
    )


def _along(correction: ContourCorrection, contour: Contour) -> Array:
    """(N,) m, springback predicted along the push of ``contour``; zero when there is none."""
    if len(correction.springback) != len(contour):
        return np.zeros(len(contour))
    return -push_sign(contour) * np.asarray(correction.springback)
