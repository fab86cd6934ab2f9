"""Method "analytic": springback from the measured force and the closed-form deflection of the sheet.

For every control point of the coming contour: forecast of the axial sheet load -> line load
q = F / (2 (l + m)) over the perimeter of the contact patch -> cubic a w^3 + b w = q with the local radius of the
opening -> correction along the push direction (Praveen 2020, eq. 1-16 and 19-22; force in place of the predicted
one and block logic: Ren 2018, 4.3.1).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult, Process, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.opening import ClampRadius, Opening
from isf_core.process.deflection import SheetSection, deflection, ring_load_law
from isf_core.process.forming_force import aerens_axial_force, contact_patch
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.continuity import Continuity, forming_radius, limits_of
from isf_springback.floor_feedback import FloorFeedback, at_edge
from isf_springback.force_forecast import ForecastLaw, forecast_along
from isf_springback.law_scale import LawScale
from isf_springback.lift_feedback import LiftReading
from isf_springback.loop_path import LoopPath, moving_average, nearest_points
from isf_springback.measured_load import MeasuredLoad, planned_force, steepest_wall
from isf_springback.sheet_edge import edge_radius
from isf_springback.sheet_load import axial_sheet_load, push_sign

SheetTerm = Literal["realised", "component", "axial"]

REALISED: dict[str, float] = {"free": 0.66, "fixed": 0.55}
"""Part of the deflection w that comes back as springback, by the in-plane condition of the clamped edge.

free: calibrated, Ren 2018 Table 4.6, 5.09 mm at 600 N where the cubic gives 7.68 mm. fixed: published, mean change
of the base error over w of the three cones of Praveen 2020, 3.2 (0.63, 0.62, 0.41). Their ratio 1.20 agrees with
the ratio of the plate formulas with free and immovable edge, 4.64 / 3.61 = 1.29 (Ren 2018 eq. 4-15)."""


@dataclass(frozen=True)
class AnalyticOptions:
    """Choices of the method.

    Attributes
    ----------
    sheet_term : how w becomes an axial correction. "realised": the constant factor :data:`REALISED`;
        "component": w n_z, the literal reading of Praveen 2020 eq. 19-22 with the local normal; "axial": w.
        The component reading equals the realised one on walls near 50 deg, but tends to the full w on the fillet
        of a floor, where springback does not grow: hence not the default.
    clamp : radius of a rectangular clamp, see :func:`isf_core.geometry.opening.clamp_radius`
    law : force forecast
    first_contour : "predicted" (by the force that the plan predicts; not corrected where the plan tells none, over a
        die, and in further stages), "zero" (not corrected, as published for block 1) or "estimate" (everywhere, by
        Aerens' regression where the plan tells none). When the tools have swapped, "predicted" does as "estimate":
        the sheet stands where springback left it, and tools at the planned height would not form.
    control_points : places along the contour where force and model are evaluated
    """

    sheet_term: SheetTerm = "realised"
    clamp: ClampRadius = "equivalent"
    law: ForecastLaw = "linear"
    first_contour: Literal["predicted", "zero", "estimate"] = "predicted"
    control_points: int = 24

    @staticmethod
    def of(job_file: JobFile, law: ForecastLaw = "linear") -> AnalyticOptions:
        """What the job chooses, with the force forecast ``law``."""
        return AnalyticOptions(law=law, first_contour=job_file.job.springback.first_contour)


@dataclass(frozen=True)
class Prediction:
    """Springback predicted for one contour, M control points, N path points.

    Attributes
    ----------
    point : (M, 3) m ; springback : (M,) m ; force : (M,) N
    along : (N,) m, springback along the path
    deviation : (N,) m, standard deviation of ``along``, or (0,)
    remarks : what a person should know about this prediction
    """

    point: Array
    springback: Array
    force: Array
    along: Array
    deviation: Array = field(default_factory=lambda: np.empty(0))
    remarks: tuple[str, ...] = ()


class AnalyticCorrection:
    """Corrects contour after contour; see the module text. State: opening, two loads, last correction, tool lifts."""

    name = "analytic"

    def __init__(self, job_file: JobFile, options: AnalyticOptions | None = None) -> None:
        self._job_file = job_file
        self._options = options or AnalyticOptions.of(job_file)
        material = job_file.material
        self._section = SheetSection(material.young_modulus, material.poisson_ratio, job_file.job.sheet.thickness)
        self._continuity = Continuity()
        self._opening: Opening | None = None
        self._feature: tuple[int, int] | None = None
        self._first_index = -1
        self._swapped = False
        self._loads: list[MeasuredLoad] = []
        self._fault: IsfError | None = None
        self._contour: Contour | None = None
        self._before: Contour | None = None
        self._floor = FloorFeedback()
        self._scale = LawScale()
        self._lift_remark = ""

    def correct(self, contour: Contour) -> ContourCorrection:
        """Correction of the next contour; never raises for missing or bad forces.

        These keep the last good correction and give its code: NO_FORCE_HISTORY (no result of the last contour),
        CORRECTION_FAILED (forces not finite), CONTOUR_OUT_OF_ORDER. CORRECTION_LIMITED: the largest correction
        was reached.

        Raises
        ------
        IsfError : CONTOUR_REJECTED, the contour itself is malformed
        """
        started = time.perf_counter()
        contour.validate()
        continuity = self._continuity
        if self._contour is not None and self._contour.index != contour.index:
            self._before = self._contour
        fault = self._advance(contour) or self._fault
        prediction: Prediction | None = None
        if fault is None:
            try:
                prediction = self._predict(contour)
            except IsfError as error:
                fault = error
        if prediction is None:
            requested = continuity.last_good(contour)
        else:
            requested = self._job_file.job.springback.gain * prediction.along
        last = continuity.last_good(contour)
        pressed = self._floor.push(contour, self._before, last)
        requested = at_edge(contour, self._job_file, requested, last) if pressed is None else pressed
        limits = limits_of(self._job_file, contour.forming_tool)
        if pressed is not None:
            limits = replace(limits, change=limits.magnitude)  # a floor may need far less push than the wall
        limited = continuity.apply_limits(contour, requested, limits)
        if pressed is not None:
            self._floor.remember(contour, limited.value)
        if fault is None and limited.magnitude_limited:
            fault = IsfError(
                ErrorCode.CORRECTION_LIMITED,
                f"{1e3 * float(requested.max()):.1f} mm asked for, the largest correction is "
                f"{1e3 * limits.magnitude:.1f} mm",
                where=contour_label(contour.index),
                advice="check the measured force, the clamp size and the sheet thickness of the job",
            )
        return _correction(self.name, contour, limited.value, limited.saturated, prediction, fault, started)

    def learn(self, contour: Contour, result: ContourResult) -> None:
        """Take the forces measured on the contour last corrected; what is wrong with them is told by ``correct``."""
        pending = self._continuity.pending
        if pending is None or (pending.plan_id, pending.index) != (result.plan_id, result.index):
            self._fault = IsfError(
                ErrorCode.CONTOUR_OUT_OF_ORDER,
                f"a result of {contour_label(result.index)} came, that of "
                f"{'none' if pending is None else contour_label(pending.index)} is next",
                where=f"plan {result.plan_id}",
                advice="results must come once and in order; the last good correction is kept",
            )
            return
        try:
            if not result.completed:
                raise IsfError(ErrorCode.NO_FORCE_HISTORY, "was not completed", where=contour_label(result.index))
            load = axial_sheet_load(contour, result)
        except IsfError as error:
            self._fault = error
            return
        self._fault = None
        path = LoopPath.of(contour)
        mean = moving_average(path, load, path.length / self._options.control_points)
        place = contour.forming_tip[:, :2].copy()
        older = [known for known in self._loads if known.index != result.index][-1:]
        steepest, planned = steepest_wall(contour.wall_angle, place, older), planned_force(contour, place, older)
        self._loads = [*older, MeasuredLoad(result.index, place, mean, steepest, planned)]

    def feel(self, reading: LiftReading | None, index: int) -> None:
        """Scale the law by what the tool lift after contour ``index`` told; a useless one is told by a remark."""
        contour = self._contour
        if reading is None or contour is None or contour.index != index:
            self._lift_remark = f"the tool lift after {contour_label(index)} told nothing; the model stays as it was"
            return
        point = int(nearest_points(reading.place[None, :2], contour.forming_tip[:, :2])[0])
        try:
            law = self._law_at(contour, point, reading.force)
        except IsfError as error:
            self._lift_remark = f"the tool lift after {contour_label(index)} is not used: {error.message}"
            return
        self._scale.take(contour.contact[point], reading, law)
        self._lift_remark = self._scale.remark()

    def lifted_share(self, place: Array) -> Array:
        """(M,) factor on the law at ``place`` (M, 3) m that tool lifts gave, at the last measured forces; 1: none."""
        force = self._loads[-1].load_at(place[:, :2]) if self._loads else np.zeros(len(place))
        return self._scale.at(place, force).factor

    def hindsight(self) -> Array | None:
        """(N,) m, springback of the contour formed last under the force measured on it; None: not known."""
        if self._contour is None or not self._loads or self._loads[-1].index != self._contour.index:
            return None
        try:
            return self._predict(self._contour).along
        except IsfError:
            return None

    def follow(self, contour: Contour, correction: ContourCorrection) -> None:
        """Take note that another method corrected ``contour``."""
        self._advance(contour)
        self._continuity.remember(contour, push_sign(contour) * np.asarray(correction.offset)[:, 2])

    def _advance(self, contour: Contour) -> IsfError | None:
        """Prepare for ``contour``; a new plan starts anew, a new feature has an own opening and force history.

        The first contour of a feature is its opening: parts are formed from the outside to the inside.
        """
        pending = self._continuity.pending
        self._contour = contour
        if pending is not None and pending.plan_id != contour.plan_id:
            self._feature = None
            self._fault = None
            self._scale.clear()
            self._lift_remark = ""
        if self._feature != (contour.feature, contour.stage):
            self._feature = (contour.feature, contour.stage)
            self._opening = Opening.of(contour.contact[:, :2])
            self._first_index = contour.index
            self._swapped = (
                pending is not None
                and pending.plan_id == contour.plan_id
                and pending.forming_tool != contour.forming_tool
            )
            self._loads = []
        return self._continuity.advance(contour)

    def _predict(self, contour: Contour) -> Prediction:
        """Springback of ``contour``; raises NO_FORCE_HISTORY."""
        path = LoopPath.of(contour)
        position = path.even_positions(self._options.control_points)
        point = np.column_stack([path.at(contour.contact[:, axis], position) for axis in range(3)])
        tip = np.column_stack([path.at(contour.forming_tip[:, axis], position) for axis in range(2)])
        angle = path.at(contour.wall_angle, position)
        force = self._forecast(contour, tip, angle)
        springback = self._springback(contour, point[:, :2], tip, angle, force)
        scale = self._scale.at(point, force)
        springback = scale.factor * springback
        period = path.length if path.closed else None
        along = np.asarray(np.interp(path.position, position, springback, period=period))
        if not len(self._scale):
            return Prediction(point, springback, force, along, remarks=self._lift_remarks())
        deviation = np.interp(path.position, position, scale.deviation * springback, period=period)
        return Prediction(point, springback, force, along, np.asarray(deviation), self._lift_remarks())

    def _lift_remarks(self) -> tuple[str, ...]:
        return (self._lift_remark,) if self._lift_remark else ()

    def _law_at(self, contour: Contour, point: int, force: Array) -> Array:
        """(K,) m, springback at path point ``point`` under ``force`` (K,) N by the law as it is computed."""
        count = len(force)
        place, tip = (np.tile(known[point, :2], (count, 1)) for known in (contour.contact, contour.forming_tip))
        return self._springback(contour, place, tip, np.full(count, contour.wall_angle[point]), force)

    def _forecast(self, contour: Contour, tip: Array, angle: Array) -> Array:
        """(M,) N, force expected at the control points; the measured one where the contour has been formed."""
        if self._loads and self._loads[-1].index == contour.index:
            return self._loads[-1].load_at(tip)
        if self._loads and self._loads[-1].index == contour.index - 1:
            last = self._loads[-1].load_at(tip)
            if self._swapped and self._options.first_contour != "zero":
                # where the support tool presses more than the forming tool nothing was formed
                last = np.where(last > 0.0, last, self._expected(contour, tip, angle))
            consecutive = len(self._loads) == 2 and self._loads[0].index == contour.index - 2
            before_last = self._loads[0].load_at(tip) if consecutive else None
            planned = [load.planned_at(tip) for load in self._loads] + [planned_force(contour, tip, self._loads[-1:])]
            return forecast_along(planned, last, before_last, self._options.law)
        if contour.index != self._first_index or (contour.feature == contour.stage == 0 and contour.index > 0):
            raise IsfError(
                ErrorCode.NO_FORCE_HISTORY,
                f"no measured force of {contour_label(contour.index - 1)}",
                where=contour_label(contour.index),
                advice="the last good correction is kept; check that force control publishes contour/result",
            )
        choice = self._options.first_contour
        free = contour.stage == 0 and contour.process is not Process.TPIF  # a die carries what it begins with
        known = free and len(contour.predicted_force) > 0
        if choice == "estimate" or (choice == "predicted" and (self._swapped or known)):
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

    def _springback(self, contour: Contour, place: Array, tip: Array, angle: Array, force: Array) -> Array:
        """(M,) m, springback against the push direction under ``force`` (M,) N.

        The contact patch is that of the steepest wall met so far: on the fillet of a floor the local angle gives a
        short patch and a high line load, though the sheet between opening and clamp feels the same force.
        """
        job_file, options = self._job_file, self._options
        assert self._opening is not None  # set by _advance
        radius = self._opening.radius_towards(place)
        outer = edge_radius(job_file, self._opening, place, options.clamp)
        tool = forming_radius(job_file, contour.forming_tool)
        wall = steepest_wall(angle, tip, self._loads[-1:])
        patch = contact_patch(wall, tool, job_file.job.path.incremental_depth)
        law = ring_load_law(self._section, outer, radius)
        return deflection(law, force / patch.perimeter) * self._axial_share(angle)

    def _axial_share(self, angle: Array) -> Array:
        if self._options.sheet_term == "component":
            return np.asarray(np.cos(angle))
        if self._options.sheet_term == "axial":
            return np.ones(len(angle))
        return np.full(len(angle), REALISED[self._job_file.rig.clamp.edge])


def _correction(
    method: str,
    contour: Contour,
    value: Array,
    saturated: NDArray[np.bool_],
    prediction: Prediction | None,
    fault: IsfError | None,
    started: float,
) -> ContourCorrection:
    """Correction message of a push ``value`` (N,) m."""
    sign = push_sign(contour)
    offset = np.zeros((len(contour), 3))
    offset[:, 2] = sign * value
    none = np.empty(0)
    return ContourCorrection(
        plan_id=contour.plan_id,
        index=contour.index,
        method=method,
        offset=offset,
        springback=none if prediction is None else -sign * prediction.along,
        control_point=np.empty((0, 3)) if prediction is None else prediction.point,
        control_point_springback=none if prediction is None else -sign * prediction.springback,
        control_point_force=none if prediction is None else prediction.force,
        saturated=saturated,
        code=0 if fault is None else int(fault.code),
        message="" if fault is None else fault.message,
        solve_time=time.perf_counter() - started,
        uncertainty=none if prediction is None else prediction.deviation,
        residual=none if prediction is None else -sign * (prediction.along - value),
        remarks=() if prediction is None else prediction.remarks,
    )
