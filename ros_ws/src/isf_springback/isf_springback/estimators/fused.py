"""Method "fused": model forward, shape back, as one estimate with its uncertainty.

Springback of the coming contour = prediction of the model from the measured force + bias of the model, estimated from
the scans. Without scans, or with scans that cannot be used, it is the model alone with the last bias: nothing jumps.

Two biases are kept. The *wall* bias is read just above the contact. Where scans show that the wall still moves after
the contact has passed (that of a stiff sheet does not: Lu 2016, zone A), the correction allows for what is to come. The
floor is made by the last contours alone; the *bottom* bias is read under and inside the tip, and takes over where the
remaining depth is less than the height of the contact above the tip. A feature formed from below, by the lower tool, is
corrected by the model alone: what a scan from above says of the wall and floor of a pocket is not true of it.

The state of a bias stands at M places around the contour: the bias (measured minus predicted springback, positive when
the sheet springs back more than the model says) and its covariance. From contour to contour it is carried by place and
drifts as a random walk; a measurement updates it place by place (Kalman), neighbours within the correlation length
share it. The method "learned" keeps such a bias against a part formed before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.errors import IsfError
from isf_core.files.job import JobFile, lift_interval
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from isf_springback.estimators.analytic import AnalyticModel, AnalyticOptions
from isf_springback.estimators.estimator import (
    Bounds,
    Estimator,
    FormedContour,
    History,
    Prediction,
    Wall,
    wall_of,
)
from isf_springback.estimators.sheet_model import SheetModel
from isf_springback.lift_feedback import LiftReading
from isf_springback.loop_path import LoopSamples, change_per_contour, forming_radii, nearest_points
from isf_springback.scan import FormedShape
from isf_springback.scan.formed_shape import floor_under
from isf_springback.scan.readings import (
    CONTOURS_PER_PLACE,
    PLACES,
    READING_DEVIATION,
    movement_to_come,
    read_errors,
    shape_remarks,
)
from isf_springback.sheet_edge import held_by_plate

LARGEST_BIAS = 3e-3
"""m; the shape may ask for that much more than was expected and no more, and may take back the correction of a model
altogether (assumed: more than half of all published springback)."""
REPORTED_BIAS = 1.5e-3
"""m of disagreement of expectation and shape that is reported."""
DRIFT_AFTER_SURPRISE = 40.0
"""Contours of drift after a scan that surprised everywhere (assumed): a surprise that comes again is a change of the
process, and is then followed within two scans."""
DOUBTFUL_SHARE = 0.25
"""Share of doubtful places from which a scan contradicts what was expected."""
DEEPER = 0.2e-3
"""m of more push than on the contour before, beyond which a contour wipes out the traces of that one."""
EDGE_CONTOURS = 2
"""Contours whose scans show the edge of the opening alone where a backing plate is close and holds it; else
:data:`CONTOURS_PER_PLACE`, since a free edge bends down with each of them."""
UNCONFIRMED_RISE = 0.5
"""Incremental depths by which a correction may grow per contour until a scan has confirmed the model (assumed: what was
formed too deep stays)."""
LARGEST_MOVEMENT = 1e-3
"""m by which a wall may be formed too deep or too high, for what it will move by later (assumed: twice what the
elasto-plastic sheet shows over a plate)."""
MOVEMENT_DRIFT = 10.0
"""Contours of drift of the movement to come per contour: it turns from sinking, beside the opening, to rising."""
MODEL_ALONE = "no scans and no tool lifts (springback.scan_every, lift_every): the correction is the model's alone"
FROM_BELOW = "scans steer the upper tool only: the feature formed from below is corrected by the model"


def steady_model(job_file: JobFile) -> SheetModel:
    """The model that the job names, with the last force held.

    With the trend of the force in the forecast, model and feedback of the shape chase each other: a larger correction
    raises the force, and the forecast raises the next correction again. On the simulated cone the correction changed
    by 0.17 mm rms from contour to contour with the trend, by 0.05 mm without, and the wall came out better.
    """
    if job_file.job.springback.fused.model == "analytic":
        first = job_file.job.springback.first_contour
        return AnalyticModel(job_file, AnalyticOptions(law="hold", first_contour=first))
    from isf_springback.estimators.elastic import ElasticModel  # numba and its kernels: only who uses them waits

    return ElasticModel(job_file, law="hold", axial_only=True)


@dataclass
class _WallEstimate:
    """What is known of one wall.

    Attributes
    ----------
    wall, bottom : biases; None before anything was measured
    steps : the contours that made the wall in reach of the scan
    confirmed : a scan has confirmed the model ; doubtful : share of the places at which the last one was implausible
    remarks : on the last scan
    movement : still to come ; scanned : contour and shape that it was read after last
    floor : m, height of the floor that it ends in, None until it is asked for
    """

    wall: BiasField | None = None
    bottom: BiasField | None = None
    steps: list[ModelledContour] = field(default_factory=list)
    confirmed: bool = False
    doubtful: float = 0.0
    remarks: tuple[str, ...] = ()
    movement: BiasField | None = None
    scanned: tuple[Contour, FormedShape] | None = None
    floor: float | None = None

    def next_wall(self) -> _WallEstimate:
        """What is known of a wall that this tool begins after this one: the biases of the model."""
        return _WallEstimate(self.wall, self.bottom, confirmed=self.confirmed, doubtful=self.doubtful)


@dataclass(frozen=True)
class ModelledContour:
    """One contour of N points: how it was pushed, and what the model says of it, with the force measured on it once
    that is known; (N,) m each."""

    contour: Contour
    pushed: Array
    model: Array


class FusedEstimator(Estimator):
    """See the module text. State: the model, and what is known of every wall."""

    name = "fused"
    uses_lifts = True
    uses_scans = True

    def __init__(self, job_file: JobFile, model: Callable[[JobFile], SheetModel] = steady_model) -> None:
        super().__init__(job_file)
        self._model = model(job_file)
        self._radius = forming_radii(job_file)
        self._change = change_per_contour(job_file)
        self._walls: dict[Wall, _WallEstimate] = {}
        self._now = _WallEstimate()
        self._first: tuple[str, int] | None = None
        self._before: Contour | None = None
        self._predicted: tuple[Contour, Array] | None = None

    def begin(self, contour: Contour, history: History) -> None:
        """As the base class; a wall begins with the bias of the one before it that was pushed the same way."""
        before, wall = self._before, history.wall
        if before is not None and before.plan_id != contour.plan_id:
            self._walls, before = {}, None
        if wall not in self._walls:
            # a further stage begins at the opening, the bias at the end of the one before is one of the floor
            alike = before is not None and wall_of(before)[1:] == wall[1:]
            self._walls[wall] = self._now.next_wall() if alike else _WallEstimate()
        self._now = self._walls[wall]
        self._before = contour
        self._predicted = None
        self._model.begin(contour, history)

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """As the base class; raises as the model does."""
        model = self._model.estimate(contour, history)
        self._predicted = contour, model.springback
        place, disagreement, deviation, moving = self._bias(contour, history)
        if self._now.wall is None and self._now.bottom is None and len(model.deviation):
            # no scan has told more than the model knows of itself, where it has a force to go by
            deviation = np.where(model.deviation > 0.0, model.deviation, deviation)
        movement = np.clip(moving, -LARGEST_MOVEMENT, LARGEST_MOVEMENT)
        bias = np.clip(disagreement, -np.maximum(model.springback, LARGEST_BIAS), LARGEST_BIAS)
        remarks = [*model.remarks, *self._now.remarks, *self._model_alone(contour)]
        if np.abs(disagreement).max() >= REPORTED_BIAS:
            followed = "" if np.array_equal(bias, disagreement) else ", which is followed only in part"
            far = float(disagreement[np.argmax(np.abs(disagreement))])
            remarks.append(f"the scanned shape shows {1e3 * far:+.1f} mm of springback relative to the model{followed}")
        remarks += implausible(self._now.doubtful)
        if not np.array_equal(moving, movement):
            far = float(moving[np.argmax(np.abs(moving))])
            way = "rises" if far > 0.0 else "sinks"
            remarks.append(
                f"scans show that a finished wall {way} by {1e3 * abs(far):.1f} mm while what is below it is formed: "
                f"the correction allows for {1e3 * LARGEST_MOVEMENT:.0f} mm"
            )
        return Prediction(
            model.springback + bias + movement,
            deviation=deviation,
            expected_error=model.expected_error,
            beside_limits=model.beside_limits,
            control_point=place,
            remarks=tuple(remarks),
            fault=history.scans.fault_before(contour),
        )

    def bounds(self, contour: Contour, history: History) -> Bounds:
        """Careful until a scan has confirmed the model: what was formed too deep stays."""
        rise = self._change
        if contour.forming_tool == 1 and self._unconfirmed():
            rise = min(rise, UNCONFIRMED_RISE * self.job_file.job.path.incremental_depth)
        return Bounds(pulls_back=True, rise=rise, by_force=True)

    def add_formed(self, formed: FormedContour, history: History) -> None:
        """As the base class; asking again for a contour replaces it."""
        contour = formed.contour
        if self._predicted is None or self._predicted[0] is not contour:
            try:
                self._predicted = contour, self._model.estimate(contour, history).springback
            except IsfError:
                self._predicted = contour, np.zeros(len(contour))
        now = self._now
        if formed.over_floor:
            return  # it says nothing of the wall
        before = [step for step in now.steps if step.contour.index < contour.index]
        now.steps = [*before[1 - CONTOURS_PER_PLACE :], ModelledContour(contour, formed.push, self._predicted[1])]

    def add_result(self, contour: Contour, result: ContourResult, history: History) -> None:
        """Forces for the model."""
        self._model.add_result(contour, result, history)
        known = self._model.hindsight()
        if known is not None and self._now.steps and self._now.steps[-1].contour.index == contour.index:
            self._now.steps[-1] = replace(self._now.steps[-1], model=known)

    def add_lift(self, reading: LiftReading | None, index: int) -> None:
        """A tool lift scales the model; as far as scans have fixed the sum of model and bias, the sum stays."""
        known = [one for one in self._walls.values() if one.steps]
        before = [[self._model.lifted_share(step.contour.contact) for step in one.steps] for one in known]
        self._model.add_lift(reading, index)
        for one, shares in zip(known, before, strict=True):
            factors = [
                self._model.lifted_share(step.contour.contact) / old
                for step, old in zip(one.steps, shares, strict=True)
            ]
            last = one.steps[-1]
            grown = (factors[-1] - 1.0) * last.model
            one.wall, one.bottom = (_shifted(bias, last.contour, grown) for bias in (one.wall, one.bottom))
            one.steps = [
                replace(step, model=factor * step.model) for step, factor in zip(one.steps, factors, strict=True)
            ]

    def add_shape(self, shape: FormedShape | None, history: History) -> None:
        """Update both biases from the shape after the contour in work."""
        current, target = history.current, history.scans.target
        if current is not None and current.contour.forming_tool != 1:
            self._now.remarks = (FROM_BELOW,)
            return
        if shape is None or current is None or target is None:
            return
        for wall, formed in history.shown.items():
            self._read(self._walls[wall], formed, len(history.walls[wall]), shape, target, history)

    # -- inside --------------------------------------------------------------------------------------

    def _read(
        self,
        now: _WallEstimate,
        current: FormedContour,
        count: int,
        shape: FormedShape,
        target: HeightMap,
        history: History,
    ) -> None:
        """Update what is known of one wall, of whose ``count`` contours ``current`` was formed last."""
        if not now.steps:
            return
        contour, began = current.contour, history.scans.began
        found = shape_remarks(shape, target, contour, self.job_file, began)
        if current.over_floor:
            now.remarks = (*shape.remarks, *found)
            return
        reading = read_errors(contour, shape, target, self._radius[contour.forming_tool], began)
        noise = np.full(len(reading.place), float(np.hypot(READING_DEVIATION, shape.noise)))
        known = self._fields(now, reading.place)
        surprise = reading.wall - expected_error(now.steps, reading.place)
        edge = EDGE_CONTOURS if held_by_plate(contour, self.job_file) else CONTOURS_PER_PLACE
        if count <= edge:
            # Still the edge of the opening: no push makes it better where it stands too high, as it always does a
            # little. Where it lies too deep the coming contours would press it deeper yet.
            surprise = np.where(surprise < 0.0, surprise, np.nan)
            if np.isfinite(surprise).any():
                now.wall, _ = updated(known[0], surprise, noise)
            return
        last = now.steps[-1]
        near = nearest_points(reading.place, contour.forming_tip[:, :2])
        self._add_movement(now, contour, shape, target, reading.place, history)
        now.wall, doubt_wall = updated(known[0], surprise, noise)
        surprise = reading.bottom - (last.model - last.pushed)[near]
        if now.bottom is not None or np.isfinite(surprise).any():
            now.bottom, _ = updated(known[1], surprise, noise)
        now.confirmed = True
        now.doubtful = float(doubt_wall.mean())
        now.remarks = (*shape.remarks, *found)

    def _model_alone(self, contour: Contour) -> tuple[str, ...]:
        """A remark with the first contour that is corrected, when nothing will be measured between contours."""
        if self._first is None or self._first[0] != contour.plan_id:
            self._first = (contour.plan_id, contour.index)
        job = self.job_file.job
        measured = job.springback.scan_every or lift_interval(job, self.name)
        return () if measured or self._first[1] != contour.index else (MODEL_ALONE,)

    def _add_movement(
        self,
        now: _WallEstimate,
        contour: Contour,
        shape: FormedShape,
        target: HeightMap,
        place: Array,
        history: History,
    ) -> None:
        """Update the movement to come, at ``place`` (M, 2) m, from the last two shapes of one wall."""
        before, now.scanned = now.scanned, (contour, shape)
        if before is None or before[0].index >= contour.index:
            return
        contours = sum(index > before[0].index for index in history.walls[wall_of(contour)])
        floor = _floor(now, contour, target)
        moved, deviation = movement_to_come(
            contour, shape, *before, contours, target, floor, self._radius[contour.forming_tool]
        )
        now.movement, _ = updated(self._moving(now, place), moved, deviation)

    def _unconfirmed(self) -> bool:
        """True while scans are to come and none has confirmed the model, or the last one contradicts it."""
        if self.job_file.job.springback.scan_every != 1:
            return False  # several contours without a scan: the model is all there is
        return not self._now.confirmed or self._now.doubtful > DOUBTFUL_SHARE

    def _fields(self, now: _WallEstimate, place: Array) -> tuple[BiasField, BiasField]:
        """Both biases at ``place`` (M, 2) m, one contour later than last time."""
        drift = 1.0 + DRIFT_AFTER_SURPRISE * now.doubtful
        wall = first_field(place) if now.wall is None else carried(now.wall, place, drift)
        bottom = first_field(place) if now.bottom is None else carried(now.bottom, place, drift)
        return wall, bottom

    def _moving(self, now: _WallEstimate, place: Array) -> BiasField:
        """The movement to come at ``place`` (M, 2) m, one contour later than last time."""
        if now.movement is None:
            return first_field(place)
        return carried(now.movement, place, MOVEMENT_DRIFT)

    def _bias(self, contour: Contour, history: History) -> tuple[Array, Array, Array, Array]:
        """Places (M, 3) m; bias, its standard deviation and the movement to come along the contour, (N,) m each."""
        samples = LoopSamples.of(contour, PLACES)
        wall, bottom = self._fields(self._now, samples.contact[:, :2])
        moving = self._moving(self._now, samples.contact[:, :2])
        target = history.scans.target
        unseen = self._now.bottom is None and history.scans.began is not None
        if target is None or unseen or contour.floor_passes:
            share = np.zeros(len(contour))  # passes over the floor make it, or the stage before has made it
        else:
            share = floor_share(contour, _floor(self._now, contour, target), self._radius[contour.forming_tool])
        on_wall, on_floor, wall_deviation, floor_deviation, movement = samples.along(
            wall.bias, bottom.bias, wall.deviation, bottom.deviation, moving.bias
        )
        bias = (1.0 - share) * on_wall + share * on_floor
        return samples.contact, bias, np.maximum(wall_deviation, floor_deviation), (1.0 - share) * movement


def _floor(now: _WallEstimate, contour: Contour, target: HeightMap) -> float:
    """m, height of the floor that the wall of ``contour`` ends in."""
    if now.floor is None:
        now.floor = floor_under(target, contour)
    return now.floor


def _shifted(known: BiasField | None, contour: Contour, grown: Array) -> BiasField | None:
    """``known`` after the model has ``grown`` by (N,) m along ``contour``: less where measured, as it was elsewhere."""
    if known is None:
        return None
    measured = 1.0 - np.clip(known.deviation / OF_A_MODEL.deviation, 0.0, 1.0) ** 2
    shift = measured * grown[nearest_points(known.place, contour.contact[:, :2])]
    return BiasField(known.place, known.bias - shift, known.covariance)


def expected_error(steps: Sequence[ModelledContour], place: Array) -> Array:
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


def implausible(doubtful: float) -> tuple[str, ...]:
    """Remark on a scan of which the share ``doubtful`` of the places surprised; none where it is small."""
    if doubtful <= DOUBTFUL_SHARE:
        return ()
    return (f"the last scan is implausible at {100 * doubtful:.0f} % of the places: it is given less weight",)


def floor_share(contour: Contour, floor: float, radius: float) -> Array:
    """(N,) 0 on the wall .. 1 where ``contour``, of a ball of ``radius`` m, makes the ``floor`` at a height of m."""
    remaining = np.abs(contour.forming_tip[:, 2] - floor)
    height = radius * (1.0 - np.cos(np.radians(50.0)))
    return np.asarray(np.clip(1.0 - remaining / height, 0.0, 1.0))


DRIFT = 0.03e-3
"""m per contour, standard deviation of the change of the bias (published: the contour-to-contour change of springback
after the first contours has one of 0.03-0.05 mm, Lu 2016, 4.3.1)."""
CORRELATION = 30e-3
"""m of path over which bias is alike (assumed, as for tool lifts: a sheet bends over tens of mm; what differs within a
few mm, as the mark where contours begin, is no springback, and no correction takes it back)."""
STEEPEST = np.radians(75.0)
"""Of a wall, as far as a shift in plan shows in its height."""
GATE = 4.0
"""Standard deviations beyond which a measurement counts as doubtful and is believed less."""


@dataclass(frozen=True)
class BiasField:
    """Bias at M places.

    Attributes
    ----------
    place : (M, 2) m ; bias : (M,) m ; covariance : (M, M) m^2
    """

    place: Array
    bias: Array
    covariance: Array

    @property
    def deviation(self) -> Array:
        """(M,) m, standard deviation."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)))


@dataclass(frozen=True)
class Prior:
    """What is known of a bias before anything was measured.

    Attributes
    ----------
    deviation : m, standard deviation
    common : share of the variance that is alike all around, so that what was measured elsewhere tells of places in the
        shadow of the tool
    shift : m, standard deviation in x and in y of where the part lies in plan, which makes a wall too deep on one side
        and the opposite one too high; beside ``deviation``
    """

    deviation: float
    common: float
    shift: float = 0.0


OF_A_MODEL = Prior(1.0e-3, 0.5)
"""Of measured minus modelled springback (assumed: a fifth of the springback of an unsupported sheet, as models
calibrated on one rig miss that of another; half of it, by sheet and clamp, everywhere)."""


def first_field(place: Array, prior: Prior = OF_A_MODEL, lever: Array | None = None) -> BiasField:
    """Nothing measured yet at ``place`` (M, 2) m; ``lever`` (M, 2) of :func:`shift_lever`, None: nothing is shifted."""
    return BiasField(place, np.zeros(len(place)), _covariance(place, prior, lever))


def carried(
    field: BiasField,
    place: Array,
    contours: float = 1.0,
    prior: Prior = OF_A_MODEL,
    lever: Array | None = None,
) -> BiasField:
    """``field`` at the places (M, 2) m of a later contour, after ``contours`` steps of drift; no more uncertain than
    :func:`first_field` there."""
    weights = _weights(place, field.place)
    spread = weights @ field.covariance @ weights.T
    drift = contours * DRIFT**2 * _correlation(place, prior.common)
    covariance = spread + drift
    most = np.diagonal(_covariance(place, prior, lever))
    scale = np.sqrt(np.minimum(1.0, most / np.maximum(np.diagonal(covariance), 1e-30)))
    return BiasField(place, weights @ field.bias, covariance * scale[:, None] * scale[None, :])


def shift_lever(contour: Contour, place: Array) -> Array:
    """(M, 2) height of the wall at ``place`` (M, 2) m of ``contour`` per way by which the part lies off in plan.

    The wall rises outwards: a part that lies off in that direction has it too deep there, and too high on the other
    side.
    """
    near = nearest_points(place, contour.contact[:, :2])
    outwards = (contour.contact - contour.forming_tip)[near, :2]
    size = np.linalg.norm(outwards, axis=1, keepdims=True)
    slope = np.tan(np.minimum(contour.wall_angle[near], STEEPEST))
    return np.asarray(-slope[:, None] * outwards / np.maximum(size, 1e-9))


def updated(field: BiasField, measured: Array, deviation: Array) -> tuple[BiasField, NDArray[np.bool_]]:
    """``field`` after ``measured`` (M,) m (NaN: not seen) with standard deviation (M,) m; and which were doubtful.

    A doubtful one (beyond :data:`GATE` standard deviations of what was expected) is not thrown away, which would make
    the estimator blind to a true change; its deviation is widened until it lies at the gate.
    """
    seen = np.isfinite(measured)
    doubtful = np.zeros(len(measured), dtype=bool)
    if not seen.any():
        return field, doubtful
    index = np.flatnonzero(seen)
    innovation = measured[index] - field.bias[index]
    prior = field.covariance[np.ix_(index, index)]
    noise = deviation[index] ** 2
    expected = np.diagonal(prior) + noise
    excess = innovation**2 > GATE**2 * expected
    noise = np.where(excess, innovation**2 / GATE**2 - np.diagonal(prior), noise)
    doubtful[index] = excess
    gain = np.linalg.solve(prior + np.diag(noise), field.covariance[index]).T
    bias = field.bias + gain @ innovation
    covariance = field.covariance - gain @ field.covariance[index]
    return BiasField(field.place, bias, 0.5 * (covariance + covariance.T)), doubtful


def _covariance(place: Array, prior: Prior, lever: Array | None) -> Array:
    """(M, M) m^2, of a bias of which nothing was measured."""
    covariance = prior.deviation**2 * _correlation(place, prior.common)
    return covariance if lever is None else covariance + prior.shift**2 * lever @ lever.T


def _correlation(place: Array, common: float) -> Array:
    """(M, M) correlation of the places: a part common to all, one that falls with distance, a small one of its own."""
    square = (cdist(place, place) / CORRELATION) ** 2
    near = (0.95 - common) * np.exp(-0.5 * square)
    return np.asarray(common + near + 0.05 * np.eye(len(place)))


def _weights(place: Array, known: Array) -> Array:
    """(M, K) interpolation weights from places ``known``: the two nearest, by inverse distance."""
    distance = cdist(place, known)
    nearest = np.argsort(distance, axis=1)[:, :2]
    rows = np.arange(len(place))[:, None]
    inverse = 1.0 / np.maximum(distance[rows, nearest], 1e-6)
    weights = np.zeros_like(distance)
    weights[rows, nearest] = inverse / inverse.sum(axis=1, keepdims=True)
    return weights
