"""Methods "mpc_vertical", "mpc_two_directional" and "mpc_tpif": contours corrected from scans (Lu 2016, chapter 3).

After every scan the step depth and the horizontal increments of the coming contours are optimised over a horizon, and
the first move is applied. A correction is the offset of the planned contour, and offsets accumulate: without
memory no correction would ever exceed one increment. The first contours run open loop; between
scans, and when a scan cannot be used, the last good offset is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from isf_core.contour import Contour, ContourResult, contour_label, over_floor
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, MpcSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.die_room import die_room, free_of_die
from isf_springback.estimators import mpc_problem, mpc_state
from isf_springback.estimators.estimator import Bounds, Estimator, History, Horizontal, Prediction
from isf_springback.estimators.mpc_problem import solve_coupled
from isf_springback.estimators.mpc_state import PolarContour, Sections, distribute
from isf_springback.loop_path import forming_radius
from isf_springback.scan import FormedShape
from isf_springback.scan.feedback import contour_over_die, target_over_die
from isf_springback.scan.formed_shape import floor_under
from isf_springback.scan.sections import contact_reach

Strategy = Literal["vertical", "two_directional", "tpif"]

DENSE = 360
"""Directions of a dense horizontal state (published: one per degree)."""
PER_DIRECTION = 36
"""Directions with a step depth of their own (assumed: a change of 50 um per mm of path needs no more)."""
CONTACT_TOLERANCE = 2e-3
"""m between the planned and the detected contact; beyond, the planned one is used."""
NEARBY = np.radians([0.0, *np.outer([3.0, 6.0, 10.0, 15.0, 30.0, 45.0, 60.0, 90.0], [-1.0, 1.0]).ravel()])
"""Where the one bottom point is looked for when the scan has a hole in the reference direction, or the die holds the
sheet there (assumed)."""
OUT_OF_DIE = 30e-3
"""m of section beyond the contact over a die."""


@dataclass(frozen=True)
class Move:
    """What the controllers ask for, as changes of the offset at the points of the coming contour.

    Attributes
    ----------
    vertical : (N,) m, along +z ; radial : (N,) m, away from the middle
    residual : (N,) m, vertical error expected after the contour
    inputs : (H,) m, step depths over the horizon in the first reference direction
    bounded : an input lies on its bound
    unseen : share of the directions without a state
    """

    vertical: Array
    radial: Array
    residual: Array
    inputs: Array
    bounded: bool
    unseen: float


class ModelPredictiveEstimator(Estimator):
    """Moves the offset of the contour before by what the newest shape asks for; see the module text."""

    needs_scans = True
    uses_scans = True
    strategy: ClassVar[Strategy]

    def __init__(self, job_file: JobFile) -> None:
        super().__init__(job_file)
        self._options: MpcSpec = job_file.job.springback.mpc
        self._die = die_room(job_file) if self.strategy == "tpif" else None
        self._fault: IsfError | None = None

    def begin(self, contour: Contour, history: History) -> None:
        """As the base class."""
        if history.current is None:
            self._fault = None

    def add_result(self, contour: Contour, result: ContourResult, history: History) -> None:
        """A contour that was not completed leaves no shape to steer by."""
        self._fault = None
        if not result.completed:
            self._fault = IsfError(ErrorCode.CORRECTION_FAILED, "was not completed", where=contour_label(result.index))

    def bounds(self, contour: Contour, history: History) -> Bounds:
        """Bounds of the job's section springback.mpc."""
        options = self._options
        rise = (options.largest_step - 1.0) * self.job_file.job.path.incremental_depth
        return Bounds(
            pulls_back=True, largest=options.largest_offset, rise=rise, by_force=True, at_floor=False, die=self._die
        )

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """As the base class.

        Raises
        ------
        IsfError : CORRECTION_FAILED, SCAN_INCOMPLETE, QP_INFEASIBLE: the shape cannot be used; the last good offset is
            kept
        """
        fault = self._fault or history.scans.fault_before(contour)
        if fault is not None:
            raise fault
        last = history.last(contour)
        move = None
        if len(history.of_wall) > self.job_file.job.springback.open_loop_contours:
            move = self._move(contour, history)
        shape = _fresh(history)
        remarks: tuple[str, ...] = () if shape is None else shape.remarks
        radial = _radial(contour)
        if move is None:
            return Prediction(np.empty(0), push=last.push, horizontal=Horizontal(radial, None), remarks=remarks)
        if move.bounded:
            remarks = ("the step depth is at its bound: the rest follows over several contours", *remarks)
        return Prediction(
            np.empty(0),
            push=last.push + contour.push_sign * move.vertical,
            horizontal=Horizontal(radial, np.sum(last.offset[:, :2] * radial, axis=1) + move.radial),
            expected_error=move.residual,
            remarks=remarks,
        )

    # -- inside --------------------------------------------------------------------------------------

    def _move(self, contour: Contour, history: History) -> Move | None:
        """First move of the optimised horizon; None between scans, and over a floor, which the corrector presses.

        Raises CORRECTION_FAILED, QP_INFEASIBLE.
        """
        if over_floor(contour, None if history.base is None else history.base.contour):
            return None
        if contour.forming_tool != 1:
            raise IsfError(
                ErrorCode.CORRECTION_FAILED,
                "scans from above steer the upper tool only",
                where=contour_label(contour.index),
                advice="use the method analytic for features formed from below",
            )
        shape, base, target = _fresh(history), history.base, history.scans.target
        if shape is None or base is None or target is None:
            return None
        options, formed = self._options, base.contour
        if self.strategy == "tpif":
            # the blank holder moves from contour to contour: only in the frame of the die do their levels descend
            formed, contour, target = contour_over_die(formed), contour_over_die(contour), target_over_die(target)
        polar = PolarContour.of(contour)
        references = np.asarray(options.reference_angles)
        dense = self.strategy == "tpif" or options.distribution == "dense"
        inside = min(float(polar.radius.max()), 40e-3) if self.strategy != "tpif" else OUT_OF_DIE
        radius = forming_radius(self.job_file, contour.forming_tool)
        horizontal = self.strategy != "vertical" and options.distribution != "none"
        angles = references
        if options.step == "per_direction":
            angles = np.concatenate([references, 2 * np.pi * np.arange(PER_DIRECTION) / PER_DIRECTION])
        cut = mpc_state.radial_sections(formed, angles, shape.surface, target, radius, inside)
        level = self._levels(formed, contour, target)
        began = history.scans.began
        error = mpc_state.bottom_error(cut, float(level[0]), began=began)
        if self.strategy == "tpif":
            near = (references[:, None] + NEARBY).ravel()
            free = self._free(formed, near)
            if not free.any():
                return None  # the die holds all that was formed last: it is right or nothing can be done
            error = np.where(self._free(formed, angles), error, np.nan)
            beside = mpc_state.radial_sections(formed, near, shape.surface, target, radius, inside)
            nearby = np.where(free, mpc_state.bottom_error(beside, float(level[0])), np.nan)
            nearby = nearby.reshape(len(references), -1)
            error[: len(references)] = nearby[np.arange(len(references)), np.argmax(np.isfinite(nearby), axis=1)]
        # over a die, and where a stage before has formed the bottom, a section tells nothing but the last contour
        inputs = self._vertical(cut, level, error, of_section=self.strategy != "tpif" and began is None)
        steps = np.diff(level)
        unseen = float(np.isnan(error).mean())
        if np.isnan(error[: len(references)]).all():
            raise IsfError(
                ErrorCode.SCAN_INCOMPLETE,
                "the scan does not show the bottom in any reference direction",
                where=contour_label(contour.index),
                advice="add springback.mpc.reference_angles where the scanner sees the part",
            )
        common = inputs[: len(references)][np.isfinite(error[: len(references)])].mean(axis=0)
        left = float(np.nanmean(error[: len(references)])) + np.concatenate([[0.0], np.cumsum(common - steps)])
        around = np.arctan2(polar.radial[:, 1], polar.radial[:, 0])
        rest = np.isfinite(error[len(references) :])
        if rest.any():
            change = (inputs[len(references) :, 0] - steps[0])[rest]
            vertical = np.interp(around, angles[len(references) :][rest], change, period=2 * np.pi)
        else:
            vertical = np.full(len(contour), common[0] - steps[0])
        sideways = np.zeros(len(contour))
        if horizontal:
            angles = 2 * np.pi * np.arange(DENSE) / DENSE if dense else references
            if dense:
                cut = mpc_state.radial_sections(formed, angles, shape.surface, target, radius, inside=25e-3)
            sideways, lost = self._horizontal(cut.pick(np.arange(len(angles))), contour, level, left, polar, dense)
            sideways = np.where(self._free(formed, polar.angle), sideways, 0.0)
            unseen = max(unseen, lost)
        lower, upper = self._bounds(level)
        return Move(
            vertical,
            sideways,
            np.full(len(contour), left[1]),
            common,
            bool((common[0] <= lower + 1e-9) | (common[0] >= upper - 1e-9)),
            unseen,
        )

    def _free(self, formed: Contour, angles: Array) -> NDArray[np.bool_]:
        """(M,) directions ``angles`` rad in which ``formed``, in the frame of the die, works beside it."""
        if self._die is None:
            return np.ones(len(angles), dtype=bool)
        polar = PolarContour.of(formed)
        away = np.abs(np.angle(np.exp(1j * (angles[:, None] - polar.angle[None, :]))))
        return np.asarray(free_of_die(self._die, formed)[np.argmin(away, axis=1)])

    def _levels(self, formed: Contour, contour: Contour, target: HeightMap) -> Array:
        """(H + 1,) m, tip levels of the contour formed last, the coming one and those after it.

        Parts formed inwards end at the floor: the horizon shrinks there. Over a die the ramp of the target goes on
        beyond the last contour (a target frozen there would leave the last contours behind).
        """
        first = float(np.mean(formed.forming_tip[:, 2]))
        second = float(np.mean(contour.forming_tip[:, 2]))
        left = contour.count - contour.index
        horizon = self._options.horizon or left
        if self.strategy == "tpif":
            horizon = max(horizon, 1)
        else:
            horizon = max(1, min(horizon, left))
        step = self.job_file.job.path.incremental_depth
        level = np.concatenate([[first], second - step * np.arange(horizon)])
        if self.strategy == "tpif":
            return level
        floor = min(floor_under(target, contour), second)
        return np.asarray(np.maximum(level, floor))

    def _bounds(self, level: Array) -> tuple[float, float]:
        """m, bounds of the signed step depth; in planned steps, so that a lag can be made good."""
        step = max(float(level[0] - level[1]), 0.2 * self.job_file.job.path.incremental_depth)
        return -self._options.largest_step * step, -self._options.smallest_step * step

    def _vertical(self, cut: Sections, level: Array, error: Array, *, of_section: bool) -> Array:
        """(M, H) m, step depths per section: from all of the section, or from the ``error`` (M,) m of the last
        contour."""
        options = self._options
        lower, upper = self._bounds(level)
        if not of_section:
            measured = level[0] + np.where(np.isfinite(error), error, 0.0)
            targets = np.tile(level[1:], (len(measured), 1))
            problem = mpc_problem.scalar_vertical_problem(measured, targets, options.vertical_weight, lower, upper)
            return mpc_problem.solve(problem, options.solver)
        wanted = mpc_state.intended_profiles(cut, level)
        problems = []
        for m in range(len(cut.directions)):
            start = self._contact(cut, m, float(wanted.contact[m, 0]))
            contact = np.concatenate([[start], wanted.contact[m, 1:]])
            zones = np.array(
                [mpc_problem.zone_coefficients(cut.reach, contact[j], contact[j + 1]) for j in range(len(level) - 1)]
            )
            formed = np.where(cut.reach >= start, cut.formed[m], np.nan)  # the formed wall does not move
            if not np.isfinite(formed).any():
                zones, formed = np.zeros_like(zones), np.zeros_like(formed)
            problems.append(
                mpc_problem.vertical_problem(
                    zones, formed, wanted.profile[m, 1:], options.vertical_weight, lower, upper
                )
            )
        joined = mpc_problem.BoxProblem(
            np.array([p.hessian for p in problems]),
            np.concatenate([p.gradient for p in problems]),
            np.concatenate([p.lower for p in problems]),
            np.concatenate([p.upper for p in problems]),
        )
        return mpc_problem.solve(joined, options.solver)

    def _contact(self, cut: Sections, m: int, planned: float) -> float:
        """m of reach, contact of section ``m`` detected on the formed wall, or the planned one."""
        one = cut.pick(np.array([m]))
        found = float(contact_reach(one.formed, one.reach, one.wall_angle)[0])
        return found if np.isfinite(found) and abs(found - planned) <= CONTACT_TOLERANCE else planned

    def _horizontal(
        self, cut: Sections, contour: Contour, level: Array, left: Array, polar: PolarContour, dense: bool
    ) -> tuple[Array, float]:
        """(N,) m radial change of the offset, and the share of directions that were not seen."""
        options = self._options
        height = cut.radius * (1.0 - np.cos(cut.wall_angle))
        ahead = level[None, :] + height[:, None]
        error = mpc_state.radius_errors(cut, ahead, np.tile(left, (len(cut.directions), 1)))
        seen = np.isfinite(error).all(axis=1)
        if not seen.any():
            return np.zeros(len(contour)), 1.0
        if options.coupled:
            departure = solve_coupled(error[seen], cut.wall_angle[seen], np.diff(level), left, options)
        else:
            problem = mpc_problem.horizontal_problem(error[seen], options.horizontal_weight, options.horizontal_change)
            departure = mpc_problem.solve(problem, options.solver)[:, 0]
        kind = "dense" if dense else options.distribution
        spread = distribute(departure, cut.angle[seen], polar.angle, polar.radius, kind)
        return np.asarray(-cut.progress * spread), float(1.0 - seen.mean())


def _fresh(history: History) -> FormedShape | None:
    """The shape measured since the contour of this wall before the one in work, None when there is none."""
    return history.scans.since(history.of_wall[-2]) if len(history.of_wall) > 1 else None


def _radial(contour: Contour) -> Array:
    """(N, 2) unit radial directions; zero where the contour has none."""
    try:
        return PolarContour.of(contour).radial
    except IsfError:
        return np.zeros((len(contour), 2))


class MpcVertical(ModelPredictiveEstimator):
    """Step depth from a section of the shape (Lu 2016, 3.2)."""

    name = "mpc_vertical"
    strategy = "vertical"


class MpcTwoDirectional(ModelPredictiveEstimator):
    """Step depth and horizontal increments (Lu 2016, 3.3)."""

    name = "mpc_two_directional"
    strategy = "two_directional"


class MpcTpif(ModelPredictiveEstimator):
    """Over a partial die: bottom point and 360 directions (Lu 2016, 3.4)."""

    name = "mpc_tpif"
    strategy = "tpif"
    over_die = True
