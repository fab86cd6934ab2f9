"""A springback model of the sheet under the measured axial force: what "analytic" and "elastic" have in common.

**Load.** Squeezing the sheet between the tools is a self-equilibrated pair: it loads the tools and not the part. The
load that deflects the sheet is the sum of the axial forces of both tools; without a reading of the support tool the
axial share of the squeeze follows from its horizontal normal force, F_nz = F_nxy cot(phi) (Ren 2018, section 2.3).
Forces are those of the sheet on the tool, N, axes of frame ``sheet``.

**Forecast** of the axial force of the coming contour from the last two. Each law is a = 1 + c, b = -c in
F_i = a F_(i-1) + b F_(i-2):

* ``hold``: c = 0.
* ``half_step``: c = 1/2, the published law 1.5 F_(i-1) - 0.5 F_(i-2) (Ren 2018 eq. 4-14). A force that rises by d
  per contour is under-predicted by d/2, and with it the springback.
* ``linear``: c = 1, no lag on a ramp (default). It doubles the noise variance of the published law (5 against
  2.5 times one reading), which is harmless because sector means of a 1 % load cell are good to about 0.1 %.

Where the plan predicts forces, what is carried on is the measured share of them (:func:`forecast_along`): a wall that
becomes steeper on its way in raises the force, which the plan knows before it is measured. The trend c (F_(i-1) -
F_(i-2)) is limited to a part of the last force: a knee of the force curve is then overrun by a bounded amount.

**Scale.** Tool lifts scale the computed springback (:mod:`isf_springback.lift_feedback`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from isf_core.contour import Contour, ContourResult, Process, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.opening import Opening
from isf_core.process.forming_force import aerens_axial_force
from isf_core.types import Array

from isf_springback.estimators.estimator import Estimator, History, Prediction
from isf_springback.lift_feedback import LiftedLaw, LiftReading
from isf_springback.loop_path import LoopPath, forming_radius, moving_average, nearest_points
from isf_springback.sheet_edge import opening_sag

SMALLEST_SQUEEZE_ANGLE = np.radians(10.0)
"""rad; below it cot(phi) says nothing any more: horizontal squeeze control is not used on nearly flat walls."""


def axial_sheet_load(contour: Contour, result: ContourResult) -> Array:
    """(N,) N, load on the sheet along the push direction at the points of ``contour``; positive when pushing.

    Raises
    ------
    IsfError : NO_FORCE_HISTORY (the result has no forces or belongs to another path),
        CORRECTION_FAILED (forces that are not finite)
    """
    where = contour_label(contour.index)
    forming = np.asarray(result.forming_force, dtype=float)
    if forming.shape != (len(contour), 3):
        raise IsfError(
            ErrorCode.NO_FORCE_HISTORY,
            f"its result has forming forces of shape {forming.shape}, expected {(len(contour), 3)}",
            where=where,
            advice="force control must report the force at every contour point",
        )
    axial = forming[:, 2] + _support_share(contour, result)
    bad = ~np.isfinite(axial)
    if bad.any():
        raise IsfError(
            ErrorCode.CORRECTION_FAILED,
            f"the measured force is not finite at {int(bad.sum())} of {len(axial)} points",
            where=f"{where} point {int(np.argmax(bad))}",
            advice="check the load cell; the last good correction is kept",
        )
    return -contour.push_sign * axial


def _support_share(contour: Contour, result: ContourResult) -> Array:
    """(N,) N, axial force on the support tool: measured, else from the horizontal normal force."""
    if not contour.has_support:
        return np.zeros(len(contour))
    support = np.asarray(result.support_force, dtype=float)
    if support.shape == (len(contour), 3):
        return np.asarray(support[:, 2])
    horizontal = contour.support_force if contour.force_controlled else np.zeros(len(contour))
    angle = np.maximum(contour.wall_angle, SMALLEST_SQUEEZE_ANGLE)
    return np.asarray(contour.push_sign * horizontal / np.tan(angle))


ForecastLaw = Literal["hold", "half_step", "linear"]
FirstContour = Literal["predicted", "zero", "estimate"]

TREND: dict[ForecastLaw, float] = {"hold": 0.0, "half_step": 0.5, "linear": 1.0}
"""Share c of the last change that is carried on."""

TREND_LIMIT = 0.25
"""Largest change of one forecast over the last force (assumed: a force that grows faster is still ramping up,
where the limits of the correction act first)."""

SAG_SCATTER = 0.2
"""Standard deviation of the sag of an opening over the sag (that of the parts it was read from: 0.14)."""

SECTORS = 24
"""Parts of the path over one of which a measured force is averaged."""


def forecast(
    last: Array, before_last: Array | None, law: ForecastLaw = "linear", trend_limit: float = TREND_LIMIT
) -> Array:
    """(M,) N, forecast at M places from the measured forces (M,) N of the last two contours.

    With one contour of history the last force is held (Ren 2018, 4.3.1: second block). Never negative.
    """
    recent: Array = np.maximum(np.asarray(last, dtype=np.float64), 0.0)
    if before_last is None:
        return recent
    trend = TREND[law] * (recent - np.maximum(before_last, 0.0))
    bound = trend_limit * recent
    return np.asarray(np.maximum(recent + np.clip(trend, -bound, bound), 0.0))


def forecast_along(planned: Sequence[Array], last: Array, before_last: Array | None, law: ForecastLaw) -> Array:
    """As :func:`forecast`, of the measured force as a share of the planned one.

    ``planned``: (M,) N at the same places on the contours in hand and, last, on the coming one; (0,) where the plan
    predicts none, and nothing is changed.
    """
    if len(planned) < (2 if before_last is None else 3) or not all(len(force) for force in planned):
        return forecast(last, before_last, law)
    coming = np.maximum(planned[-1], 1.0)
    older = None if before_last is None else before_last * coming / np.maximum(planned[-3], 1.0)
    return forecast(last * coming / np.maximum(planned[-2], 1.0), older, law)


@dataclass(frozen=True)
class MeasuredLoad:
    """What was measured on one contour, N points.

    Attributes
    ----------
    index : the contour
    place : (N, 2) m
    load : (N,) N, axial sheet load averaged over a sector of path
    steepest : (N,) rad, steepest wall met here on the way in from the opening
    planned : (N,) N, largest force that the plan predicted here on the way in, or (0,) when it predicts none
    """

    index: int
    place: Array
    load: Array
    steepest: Array
    planned: Array = field(default_factory=lambda: np.empty(0))

    def seen_from(self, points: Array) -> MeasuredLoad:
        """The same at the nearest places in plan view of ``points`` (M, 2) m."""
        near = nearest_points(points, self.place)
        planned = self.planned[near] if len(self.planned) else self.planned
        return MeasuredLoad(self.index, points, self.load[near], self.steepest[near], planned)


@dataclass(frozen=True)
class ExpectedForce:
    """Force expected at M places of a contour: ``force`` (M,) N, and ``steepest`` (M,) rad, steepest wall met there."""

    force: Array
    steepest: Array


def predicted_force(contour: Contour, place: Array) -> Array:
    """(M,) N, force that the plan predicts at ``place`` (M, 2) m; (0,): none."""
    if not len(contour.predicted_force):
        return np.empty(0)
    return np.asarray(contour.predicted_force[nearest_points(place, contour.forming_tip[:, :2])])


def largest_planned(force: Array, before: MeasuredLoad | None) -> Array:
    """(M,) N, ``force`` (M,) N, or that of the contour before at the same places, if that is more; (0,): none."""
    if not len(force) or before is None or not len(before.planned):
        return force
    return np.maximum(force, before.planned)


@dataclass
class _FeatureLoads:
    """What is known of one feature in one stage; kept while the tools work on another one and come back.

    Attributes
    ----------
    opening : its first contour; None before any
    swapped : the tools swapped their roles just before it
    late : it is the first one of the plan and its first contour is not known: the plan was taken up in the middle
    begun : indices of its contours so far, the one in work last
    loads : measured on the last contour that has them, after that of the one before
    blocks : the same in blocks of contours, the one being filled last
    fault : why the newest result is of no use; None: it is of use
    """

    opening: Opening | None = None
    swapped: bool = False
    late: bool = False
    begun: list[int] = field(default_factory=list)
    loads: list[MeasuredLoad] = field(default_factory=list)
    blocks: list[list[MeasuredLoad]] = field(default_factory=lambda: [[]])
    fault: IsfError | None = None


class AxialForce:
    """Measured loads of every feature and stage, and the forecast from those of the one in work.

    Parameters
    ----------
    law : of the forecast
    first : force on the first block of a feature. "predicted": what the plan predicts; 0 where it predicts none, over a
        die, and in further stages. "zero": 0, as published for block 1. "estimate": everywhere, by Aerens' regression
        where the plan predicts none. When the tools have swapped, "predicted" does as "estimate": the sheet stands
        where springback left it, and tools at the planned height would not form.
    block : contours over which the force is averaged; 1: every contour by its own (Ren 2018, 4.3.1)

    Attributes
    ----------
    opening : first contour of the feature in work: parts are formed from the outside to the inside; None before any
    """

    def __init__(
        self, job_file: JobFile, law: ForecastLaw = "linear", first: FirstContour = "predicted", block: int = 1
    ) -> None:
        self._job_file = job_file
        self._law = law
        self._first = first
        self._block = block
        self._features: dict[tuple[int, int], _FeatureLoads] = {}
        self._now = _FeatureLoads()
        self.opening: Opening | None = None

    def begin(self, contour: Contour, before: Contour | None) -> None:
        """``contour`` is next, after ``before``; a new plan starts anew, a feature has an own opening and loads."""
        if before is not None and before.plan_id != contour.plan_id:
            self._features = {}
            before = None
        key = contour.feature, contour.stage
        if key not in self._features:
            self._features[key] = _FeatureLoads(
                Opening.of(contour.contact[:, :2]),
                swapped=before is not None and before.forming_tool != contour.forming_tool,
                late=before is None and contour.feature == contour.stage == 0 and contour.index > 0,
            )
        self._now = self._features[key]
        self.opening = self._now.opening
        self._now.begun = [*(index for index in self._now.begun if index < contour.index), contour.index]

    def add(self, contour: Contour, result: ContourResult, history: History) -> None:
        """Forces measured on the contour in work, as it was corrected; what is wrong with them :meth:`check` raises."""
        current = None if history.current is None else history.current.contour
        if current is None or (current.plan_id, current.index) != (result.plan_id, result.index):
            self._now.fault = IsfError(
                ErrorCode.CONTOUR_OUT_OF_ORDER,
                f"a result of {contour_label(result.index)} came, that of "
                f"{'none' if current is None else contour_label(current.index)} is next",
                where=f"plan {result.plan_id}",
                advice="results must come once and in order; the last good correction is kept",
            )
            return
        try:
            if not result.completed:
                raise IsfError(ErrorCode.NO_FORCE_HISTORY, "was not completed", where=contour_label(result.index))
            load = axial_sheet_load(contour, result)
        except IsfError as error:
            self._now.fault = error
            return
        self._now.fault = None
        path = LoopPath.of(contour)
        mean = moving_average(path, load, path.length / SECTORS)
        place = contour.forming_tip[:, :2].copy()
        now = self._now
        older = [known for known in now.loads if known.index != result.index][-1:]
        before = older[0].seen_from(place) if older else None
        steepest = np.array(contour.wall_angle) if before is None else np.maximum(contour.wall_angle, before.steepest)
        planned = largest_planned(predicted_force(contour, place), before)
        now.loads = [*older, MeasuredLoad(result.index, place, mean, steepest, planned)]
        now.blocks[-1].append(now.loads[-1])
        if len(now.blocks[-1]) >= self._block:
            now.blocks = [*now.blocks[-2:], []]

    def check(self) -> None:
        """Raises IsfError NO_FORCE_HISTORY, CORRECTION_FAILED, CONTOUR_OUT_OF_ORDER: the last result is of no use."""
        if self._now.fault is not None:
            raise self._now.fault

    def measured(self, contour: Contour) -> bool:
        """True when the force of this very contour was measured."""
        return bool(self._now.loads) and self._now.loads[-1].index == contour.index

    def steepest(self, angle: Array, place: Array) -> Array:
        """(M,) rad, steepest wall met so far at ``place`` (M, 2) m where it is ``angle`` (M,) rad now."""
        loads = self._now.loads
        return np.maximum(angle, loads[-1].seen_from(place).steepest) if loads else np.array(angle)

    def at(self, contour: Contour, tip: Array, angle: Array) -> ExpectedForce:
        """Force expected on ``contour`` at ``tip`` (M, 2) m; the measured one where it has been formed.

        ``angle`` (M,) rad is the wall angle there. Raises IsfError NO_FORCE_HISTORY.
        """
        newest = self._now.loads[-1].seen_from(tip) if self._now.loads else None
        steepest = np.array(angle) if newest is None else np.maximum(angle, newest.steepest)
        return ExpectedForce(self._force_at(contour, tip, angle, newest), steepest)

    def _force_at(self, contour: Contour, tip: Array, angle: Array, newest: MeasuredLoad | None) -> Array:
        """(M,) N, after the ``newest`` load seen from ``tip``."""
        now = self._now
        earlier = now.begun[:-1]  # of this feature: between them the tools may have formed others
        if self._block > 1 and not self.measured(contour):
            whole = [block for block in now.blocks if len(block) >= self._block]
            if whole:
                means = [np.mean([known.seen_from(tip).load for known in block], axis=0) for block in whole[-2:]]
                return forecast(means[-1], means[0] if len(means) == 2 else None, self._law)
            if len(earlier) <= self._block and not now.late:
                return self._before_any(contour, tip, angle)
        if newest is not None and newest.index == contour.index:
            return newest.load
        if newest is not None and newest.index in earlier[-1:]:
            last = newest.load
            if now.swapped and self._first != "zero":
                # where the support tool presses more than the forming tool nothing was formed
                last = np.where(last > 0.0, last, self._expected(contour, tip, angle))
            older = now.loads[0].seen_from(tip) if len(now.loads) == 2 else None
            before_last = older.load if older is not None and older.index in earlier[-2:-1] else None
            planned = [load.planned for load in (older, newest) if load is not None]
            planned.append(largest_planned(predicted_force(contour, tip), newest))
            return forecast_along(planned, last, before_last, self._law)
        if earlier or now.late:
            raise IsfError(
                ErrorCode.NO_FORCE_HISTORY,
                f"no measured force of {contour_label(earlier[-1] if earlier else contour.index - 1)}",
                where=contour_label(contour.index),
                advice="the last good correction is kept; check that force control publishes contour/result",
            )
        return self._before_any(contour, tip, angle)

    def _before_any(self, contour: Contour, tip: Array, angle: Array) -> Array:
        """(M,) N, force at ``tip`` (M, 2) m, ``angle`` (M,) rad, on a contour or block with none to go by."""
        free = contour.stage == 0 and contour.process is not Process.TPIF  # a die carries what it begins with
        known = free and len(contour.predicted_force) > 0
        if self._first == "estimate" or (self._first == "predicted" and (self._now.swapped or known)):
            return self._expected(contour, tip, angle)
        return np.zeros(len(tip))

    def _expected(self, contour: Contour, tip: Array, angle: Array) -> Array:
        """(M,) N, force at ``tip`` (M, 2) m, ``angle`` (M,) rad, before any was measured."""
        if len(contour.predicted_force):
            return np.asarray(contour.predicted_force[nearest_points(tip, contour.forming_tip[:, :2])])
        job = self._job_file.job
        return aerens_axial_force(
            self._job_file.material.tensile_strength,
            job.sheet.thickness,
            forming_radius(self._job_file, contour.forming_tool),
            job.path.incremental_depth,
            angle,
        )


class SheetModel(Estimator):
    """Springback as a function of the axial force.

    Attributes
    ----------
    force : measured loads and their forecast
    lifted : what tool lifts make of the computed springback
    lift_remarks : what the newest tool lift says, for a person
    """

    uses_lifts = True

    def __init__(self, job_file: JobFile, force: AxialForce) -> None:
        super().__init__(job_file)
        self.force = force
        self.lifted = LiftedLaw()
        self._contour: Contour | None = None
        self.lift_remarks: tuple[str, ...] = ()

    @abstractmethod
    def predict(self, contour: Contour) -> Prediction:
        """Springback of ``contour`` under the force expected, or, once it is formed, measured on it.

        Raises
        ------
        IsfError : what the model lacks
        """

    @abstractmethod
    def springback_under(self, contour: Contour, point: int, force: Array) -> Array:
        """(K,) m, springback at path point ``point`` under ``force`` (K,) N, before tool lifts; raises as predict."""

    def begin(self, contour: Contour, history: History) -> None:
        """As the base class."""
        before = self._contour
        if before is not None and before.plan_id != contour.plan_id:
            self.lifted.clear()
            self.lift_remarks = ()
        self.force.begin(contour, before)
        self._contour = contour

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """As the base class; raises NO_FORCE_HISTORY, CORRECTION_FAILED, CONTOUR_OUT_OF_ORDER, as :meth:`predict`.

        At an opening the error is foreseen that its :func:`~isf_springback.sheet_edge.opening_sag` leaves.
        """
        self.force.check()
        prediction = self.predict(contour)
        sag = opening_sag(contour, self.job_file) if history.of_wall == [contour.index] else 0.0
        if sag == 0.0 or not len(prediction.deviation):
            return prediction
        known = prediction.deviation > 0.0
        return replace(
            prediction,
            expected_error=np.full(len(contour), sag * contour.push_sign),
            beside_limits=True,
            deviation=np.where(known, np.hypot(prediction.deviation, SAG_SCATTER * sag), 0.0),
        )

    def add_result(self, contour: Contour, result: ContourResult, history: History) -> None:
        """As the base class."""
        self.force.add(contour, result, history)

    def add_lift(self, reading: LiftReading | None, index: int) -> None:
        """Change the law by the tool lift after contour ``index``; a useless one is reported by a remark."""
        contour = self._contour
        if reading is None or contour is None or contour.index != index:
            self.lift_remarks = (
                f"the tool lift after {contour_label(index)} gave no usable reading; the model stays as it was",
            )
            return
        point = int(nearest_points(reading.place[None, :2], contour.forming_tip[:, :2])[0])
        try:
            law = self.springback_under(contour, point, reading.force)
            said = self._said_of(contour, point)
        except IsfError as error:
            self.lift_remarks = (f"the tool lift after {contour_label(index)} is not used: {error.message}",)
            return
        self.lifted.add(contour.contact[point], reading, law, said)
        remark = self.lifted.remark()
        self.lift_remarks = (remark,) if remark else ()

    def _said_of(self, contour: Contour, point: int) -> float | None:
        """m, springback at ``point`` of ``contour`` under the load measured on it, before tool lifts.

        None: the law is compared under the force with which a lift begins. Only with the support tool under the blank,
        beside the contact, is that another load: what both forces sum up to is then more than what holds the sheet
        alone, once the support tool has left for the lift.
        """
        if not (self.job_file.job.support_stays and contour.has_support and self.force.measured(contour)):
            return None
        tip = contour.forming_tip[point : point + 1, :2]
        load = self.force.at(contour, tip, contour.wall_angle[point : point + 1]).force
        return float(self.springback_under(contour, point, load)[0])

    def lifted_share(self, place: Array) -> Array:
        """(M,) factor on the springback at ``place`` (M, 3) m by tool lifts; 1: none."""
        return self.lifted.share_at(place)

    def hindsight(self) -> Array | None:
        """(N,) m, springback of the contour formed last under the force measured on it; None: not known."""
        if self._contour is None or not self.force.measured(self._contour):
            return None
        try:
            return self.predict(self._contour).springback
        except IsfError:
            return None
