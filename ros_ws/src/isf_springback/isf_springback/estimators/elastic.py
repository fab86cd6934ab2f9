"""Method "elastic": springback from the measured force and the shell model of the partly formed sheet.

For every contour: forecast of the axial load -> displacement at the control points by their load-displacement laws ->
interpolation along the loop (Ren 2018, 4.3.1). The laws come from the part's database; where there is none they are
computed here, at few points on a coarse mesh, which takes up to a second once per millimetre of depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from isf_core.contour import Contour, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.database.control_points import ControlLoop, ControlPointOptions, control_loop, part_symmetries
from isf_springback.database.database import Database, DatabaseLevel, database_of
from isf_springback.database.elastic_samples import depth_task, load_levels, solve_depth
from isf_springback.database.load_displacement import CubicLaw
from isf_springback.estimators.estimator import History, Horizontal, Prediction
from isf_springback.estimators.horizontal_springback import HorizontalSpringback, across_level, outward
from isf_springback.estimators.sheet_model import AxialForce, ForecastLaw, SheetModel
from isf_springback.loop_path import LoopPath, forming_radius, nearest_points
from isf_springback.sheet_edge import holding_size
from isf_springback.shell.formed_sheet import FacetSize

FORCE_DEVIATION = 30.0
"""N, standard deviation of the force forecast (measured on the simulated plant, see docs/methods/springback.md)."""

BEYOND_SAMPLES = 1.25
"""A force this many times the largest sample is reported."""

_POINTS_ONLINE = 4
_LEVELS_ONLINE = 4
"""Points and load levels computed while forming; they bound the time."""

_SAME_PLACE = 1e-3
"""m; farther from its contour than this a control point belongs to another plan."""


@dataclass(frozen=True)
class _Laws:
    """Laws of one level of one feature in one stage: points (M, 3) m, ``largest`` N of the samples."""

    index: int
    feature: int
    stage: int
    points: Array
    cubic: CubicLaw
    largest: float


class ElasticModel(SheetModel):
    """See the module text. State beyond the base class: contours so far, laws."""

    name = "elastic"

    def __init__(
        self,
        job_file: JobFile,
        database: Database | None = None,
        law: ForecastLaw | None = None,
        *,
        axial_only: bool = False,
    ) -> None:
        """``database`` in place of the one that the job names or the cache holds; ``law`` in place of its forecast;
        ``axial_only``: z alone, whatever the job says.

        A named database that cannot be used is reported by every estimate (DATABASE_UNUSABLE, FILE_NOT_FOUND); the
        contours then pass with the last good correction.
        """
        spec = job_file.job.springback
        force = AxialForce(job_file, law or spec.elastic.forecast, spec.first_contour, block=spec.elastic.block)
        super().__init__(job_file, force)
        self._elastic = spec.elastic
        self._across = HorizontalSpringback(job_file) if spec.elastic.horizontal and not axial_only else None
        self._seen: list[Contour] = []
        self._unusable: IsfError | None = None
        self._remark = ""
        self._levels: list[_Laws] = []
        try:
            found = database or database_of(job_file)
        except IsfError as error:
            found, self._unusable = None, error
        self._from_database = found is not None
        if found is not None:
            self._levels = [_laws_of(level, found.loads) for level in found.levels]

    def begin(self, contour: Contour, history: History) -> None:
        """As the base class."""
        super().begin(contour, history)
        if self._seen and self._seen[-1].plan_id != contour.plan_id:
            self._seen = []
            if not self._from_database:
                self._levels = []
        self._seen = [known for known in self._seen if known.index < contour.index]
        self._seen.append(contour)
        if self._across is not None:
            self._across.begin(contour)

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """As the base class; across the wall too when the job asks for it."""
        prediction = super().estimate(contour, history)
        if self._across is None:
            return prediction
        remarks = prediction.remarks
        try:
            if self._across.due(contour):
                loop = self._control_loop(contour)
                points, served, row = _few(loop)
                kept = replace(loop, points=loop.points[served])
                self._across.level = across_level(self._seen, kept, points, row, self.job_file)
        except IsfError as error:
            remarks += (f"{contour_label(contour.index)}: not corrected across the wall: {error.message}",)
        across = Horizontal(outward(contour), self._across.wanted(contour))
        return replace(prediction, horizontal=across, remarks=remarks)

    def add_result(self, contour: Contour, result: ContourResult, history: History) -> None:
        """As the base class."""
        super().add_result(contour, result, history)
        if self._across is not None:
            self._across.add_result(contour, result)

    def predict(self, contour: Contour) -> Prediction:
        """As the base class; raises NO_FORCE_HISTORY; SHEET_MESH_FAILED, SHELL_NOT_SOLVED (computed here);
        DATABASE_UNUSABLE."""
        if self._unusable is not None:
            raise self._unusable
        path = LoopPath.of(contour)
        low, high, share = self._levels_around(contour)
        first = self._on_level(contour, path, low)
        if share == 0.0:
            return first
        second = self._on_level(contour, path, high)
        nearer = second if share > 0.5 else first
        return replace(
            nearer,
            springback=(1.0 - share) * first.springback + share * second.springback,
            deviation=(1.0 - share) * first.deviation + share * second.deviation,
        )

    def _on_level(self, contour: Contour, path: LoopPath, laws: _Laws) -> Prediction:
        """Prediction with the laws of one level, carried to the nearest places of ``contour``."""
        place = nearest_points(laws.points[:, :2], contour.contact[:, :2])
        order = np.argsort(path.position[place], kind="stable")
        place, cubic = place[order], CubicLaw(laws.cubic.k[order])
        force = _around(path, self.force.at(contour, contour.forming_tip[:, :2], contour.wall_angle).force, place)
        law = cubic.displacement(force)
        lifted = self.lifted.at(contour.contact[place], law)
        springback = lifted.springback
        by_force = np.where(force > 0.0, FORCE_DEVIATION / np.maximum(cubic.stiffness(law), 1.0), 0.0)
        by_force *= np.divide(springback, law, out=np.ones_like(law), where=law > 0.0)
        deviation = np.hypot(lifted.deviation, by_force)
        period = path.length if path.closed else None
        along, spread = (
            np.interp(path.position, path.position[place], values, period=period) for values in (springback, deviation)
        )
        remarks = ((self._remark,) if self._remark else ()) + self.lift_remarks
        if float(force.max()) > BEYOND_SAMPLES * laws.largest:
            remarks += (
                f"{contour_label(contour.index)}: force {float(force.max()):.0f} N is beyond the computed loads "
                f"(up to {laws.largest:.0f} N); raise springback.elastic.largest_load",
            )
        return Prediction(
            along,
            deviation=spread,
            control_point=contour.contact[place],
            control_point_springback=springback,
            control_point_force=force,
            remarks=remarks,
        )

    def springback_under(self, contour: Contour, point: int, force: Array) -> Array:
        """As the base class, from the laws of the control points."""
        if self._unusable is not None:
            raise self._unusable
        path = LoopPath.of(contour)
        low, high, share = self._levels_around(contour)

        def on_level(laws: _Laws) -> Array:
            place = nearest_points(laws.points[:, :2], contour.contact[:, :2])
            order = np.argsort(path.position[place], kind="stable")
            cubic, position = CubicLaw(laws.cubic.k[order]), path.position[place[order]]
            here, period = path.position[point], path.length if path.closed else None
            each = [cubic.displacement(np.full(len(order), load)) for load in force]
            return np.array([float(np.interp(here, position, values, period=period)) for values in each])

        return on_level(low) if share == 0.0 else (1.0 - share) * on_level(low) + share * on_level(high)

    def _levels_around(self, contour: Contour) -> tuple[_Laws, _Laws, float]:
        """Levels before and after ``contour`` and the share of the second one."""
        if self._from_database and not (self._of_stage(contour) and self._belongs(contour)):
            self._from_database, self._levels = False, []
            self._remark = (
                "the springback database belongs to another plan, or lacks this stage; computed while forming"
            )
        if not self._from_database:
            self._compute_if_due(contour)
        own = self._of_stage(contour)
        if not own:
            raise IsfError(
                ErrorCode.DATABASE_UNUSABLE,
                f"no control points for feature {contour.feature} in stage {contour.stage}",
                where=contour_label(contour.index),
                advice="make the database again with: isf springback database JOB",
            )
        before = [laws for laws in own if laws.index <= contour.index]
        after = [laws for laws in own if laws.index > contour.index]
        low = before[-1] if before else after[0]
        high = after[0] if after else low
        span = high.index - low.index
        return low, high, 0.0 if span <= 0 else (contour.index - low.index) / span

    def _of_stage(self, contour: Contour) -> list[_Laws]:
        """Levels of the feature and stage of ``contour``: what a stage has formed holds the sheet of the next one."""
        return [laws for laws in self._levels if (laws.feature, laws.stage) == (contour.feature, contour.stage)]

    def _belongs(self, contour: Contour) -> bool:
        """False when this very contour is in the database but runs elsewhere."""
        own = [laws for laws in self._levels if laws.index == contour.index]
        if not own:
            return True
        nearest = nearest_points(own[0].points[:, :2], contour.contact[:, :2])
        return bool(np.linalg.norm(own[0].points - contour.contact[nearest], axis=1).max() < _SAME_PLACE)

    def _compute_if_due(self, contour: Contour) -> None:
        """Add a level for ``contour`` when it is a loop increment deeper than the last one."""
        depth = float(contour.contact[:, 2].mean())
        own = self._of_stage(contour)
        due = self._elastic.loop_increment - 1e-6
        if own and abs(depth - float(own[-1].points[:, 2].mean())) < due:
            return
        loop = self._control_loop(contour)
        points, served, row = _few(loop)
        loads = load_levels(self._elastic.largest_load, _LEVELS_ONLINE)
        task = depth_task(self._seen, points, self.job_file, size=FacetSize.coarse(), loads=loads)
        samples = solve_depth(task)[row]
        points, central = loop.points[served], loop.central[served]
        level = DatabaseLevel(contour.index, contour.feature, depth, points, central, samples, contour.stage)
        self._levels.append(_laws_of(level, loads))

    def _control_loop(self, contour: Contour) -> ControlLoop:
        radius = forming_radius(self.job_file, contour.forming_tool)
        options = ControlPointOptions(loop_increment=self._elastic.loop_increment)
        symmetries = part_symmetries([contour], holding_size(self.job_file), options.symmetry_tolerance)
        return control_loop(contour, radius, options, symmetries)


def _around(path: LoopPath, values: Array, place: NDArray[np.intp]) -> Array:
    """(M,) means of a loop function over the stretches nearest to the points ``place`` (M,) of the path.

    A control point stands for its stretch: on a cone the one point carries the mean force of the whole loop.
    """
    apart = np.abs(path.position[:, None] - path.position[place])
    if path.closed:
        apart = np.minimum(apart, path.length - apart)
    owner = np.argmin(apart, axis=1)
    count = np.bincount(owner, minlength=len(place))
    total = np.bincount(owner, values, minlength=len(place))
    return np.where(count > 0, total / np.maximum(count, 1), values[place])


def _laws_of(level: DatabaseLevel, loads: Array) -> _Laws:
    return _Laws(level.index, level.feature, level.stage, level.points, level.cubic(loads), float(loads[-1]))


def _few(loop: ControlLoop) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Places (M, 2) m to compute, at most :data:`_POINTS_ONLINE`; the control points they serve, and the row of each.

    Middles of stretches come before boundaries; of too many, evenly spread ones are kept.
    """
    wanted = loop.computed[np.argsort(~loop.central[loop.computed], kind="stable")]
    middles = wanted[loop.central[wanted]]
    wanted = middles if len(middles) >= _POINTS_ONLINE else wanted
    if len(wanted) > _POINTS_ONLINE:
        wanted = wanted[np.linspace(0, len(wanted), _POINTS_ONLINE, endpoint=False).astype(np.int64)]
    served = np.flatnonzero(np.isin(loop.same_as, wanted))
    row = np.array([int(np.flatnonzero(wanted == point)[0]) for point in loop.same_as[served]], dtype=np.int64)
    return loop.points[wanted, :2], served, row
