"""Methods "mpc_vertical", "mpc_two_directional" and "mpc_tpif": contours corrected from scans (Lu 2016, chapter 3).

After every scan the step depth and the horizontal increments of the coming contours are optimised over a horizon, and
the first move is applied. A correction is told as the offset of the planned contour: offsets accumulate (trap H2 of
the source: without memory no correction would ever exceed one increment). The first contours run open loop; between
scans, and when a scan cannot be used, the last good offset is kept.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, MpcSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback import mpc_problem, mpc_state
from isf_springback.continuity import forming_radius
from isf_springback.die_room import die_room, free_of_die, within_room
from isf_springback.floor_feedback import FloorFeedback
from isf_springback.loop_path import LoopPath
from isf_springback.mpc_coupled import solve_coupled
from isf_springback.mpc_distribution import distribute
from isf_springback.mpc_state import PolarContour, Sections
from isf_springback.offset_memory import OffsetMemory, horizontal_limits, limit_signed, push_limits
from isf_springback.scan_memory import ScanMemory, contour_over_die, target_over_die
from isf_springback.scan_processing.sections import contact_reach
from isf_springback.sheet_load import push_sign
from isf_springback.step_bounds import largest_rise
from isf_springback.step_force import StepForce, depth_of, step_remark

Strategy = Literal["vertical", "two_directional", "tpif"]

DENSE = 360
"""Directions of a dense horizontal state (published: one per degree)."""
PER_DIRECTION = 36
"""Directions with a step depth of their own (assumed: a change of 50 um per mm of path needs no more)."""
DIE_REMARK = "the die leaves no room for more correction where the contour works over it"
CONTACT_TOLERANCE = 2e-3
"""m between the planned and the detected contact; beyond, the planned one is used."""


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


class ModelPredictiveCorrection:
    """Corrects contour after contour from scans. State: the last offsets, the newest shape."""

    def __init__(self, job_file: JobFile, strategy: Strategy) -> None:
        self.name = f"mpc_{strategy}"
        self._strategy = strategy
        self._job_file = job_file
        self._options: MpcSpec = job_file.job.springback.mpc
        self._memory = OffsetMemory()
        self._scans = ScanMemory(job_file, over_die=strategy == "tpif")
        self._die = die_room(job_file) if strategy == "tpif" else None
        self._fault: IsfError | None = None
        self._step_force = StepForce(job_file)
        self._floor = FloorFeedback()

    def take_target(self, target: HeightMap) -> None:
        """The shape that is wanted."""
        self._scans.target = target

    def see(self, points: Array, index: int) -> None:
        """The shape after contour ``index``; what is wrong with it is told by the next correction."""
        pending = self._memory.pending
        shape = self._scans.take(points, None if pending is None else pending.contour, index)
        if shape is not None and self._scans.target is not None:
            self._floor.see(shape.surface, self._scans.target)

    def learn(self, contour: Contour, result: ContourResult) -> None:
        """Forces only bound the step; a contour that was not completed leaves no shape to steer by."""
        self._fault = None
        self._step_force.take(contour, result)
        if not result.completed:
            self._fault = IsfError(ErrorCode.CORRECTION_FAILED, "was not completed", where=contour_label(result.index))

    def follow(self, contour: Contour, correction: ContourCorrection) -> None:
        """Take note that another method corrected ``contour``."""
        self._advance(contour)
        self._memory.remember(contour, np.asarray(correction.offset))

    def correct(self, contour: Contour) -> ContourCorrection:
        """Correction of the next contour; keeps the last good one, with a code, when the shape is not known.

        Raises
        ------
        IsfError : CONTOUR_REJECTED, the contour itself is malformed
        """
        started = time.perf_counter()
        contour.validate()
        fault = self._advance(contour) or self._fault or self._scans.fault_before(contour)
        memory, options = self._memory, self._options
        before = memory.last(contour)
        remarks: list[str] = []
        move: Move | None = None
        tool, sign = contour.forming_tool, push_sign(contour)
        base = memory.base
        passed = self._floor.push(contour, None if base is None else base.contour, sign * before[:, 2])
        if passed is None and fault is None and contour.index >= self._job_file.job.springback.open_loop_contours:
            try:
                move = self._move(contour)
            except IsfError as error:
                fault = error
        path = LoopPath.of(contour)
        radial, known = _radial(contour)
        old = np.sum(before[:, :2] * radial, axis=1)
        wanted = before[:, 2] if move is None else before[:, 2] + move.vertical
        wide = old if move is None else old + move.radial
        wanted = wanted if passed is None else sign * passed
        admitted = sign * self._borne(contour, sign * before[:, 2], sign * wanted, remarks)
        free = None if passed is None else options.largest_offset  # a floor may need far less push than the wall
        limits = push_limits(self._job_file, tool, max(options.largest_offset, float((-sign * admitted).max())), free)
        vertical, bound = limit_signed(admitted, path, limits, before[:, 2])
        limits = horizontal_limits(self._job_file, tool, options.largest_offset)
        horizontal, bound_h = limit_signed(wide, path, limits, old) if known else (old, np.zeros(len(old), bool))
        offset = np.column_stack([horizontal[:, None] * radial if known else before[:, :2], vertical])
        if self._die is not None:
            offset, pressed = within_room(self._die, contour_over_die(contour), offset)
            bound |= pressed
            if pressed.any():
                remarks.append(DIE_REMARK)
        memory.remember(contour, offset)
        if passed is not None:
            self._floor.remember(contour, sign * offset[:, 2])
        if fault is None and max(np.abs(wanted).max(), np.abs(wide).max()) > options.largest_offset:
            fault = IsfError(
                ErrorCode.CORRECTION_LIMITED,
                f"more than {1e3 * options.largest_offset:.1f} mm were asked for",
                where=contour_label(contour.index),
                advice="check clamp, sheet and registration of the scanner",
            )
        if move is not None and move.bounded:
            remarks.append("the step depth is at its bound: the lag is made good over several contours")
        shape = self._scans.fresh(contour)
        return ContourCorrection(
            plan_id=contour.plan_id,
            index=contour.index,
            method=self.name,
            offset=offset,
            springback=np.empty(0),
            saturated=bound | bound_h,
            code=0 if fault is None else int(fault.code),
            message="" if fault is None else fault.message,
            solve_time=time.perf_counter() - started,
            residual=np.empty(0) if move is None else move.residual,
            remarks=(*remarks, *(shape.remarks if shape is not None else ())),
        )

    # -- inside --------------------------------------------------------------------------------------

    def _borne(self, contour: Contour, before: Array, push: Array, remarks: list[str]) -> Array:
        """(N,) m, as much of ``push`` (N,) m as step and force allow after the push ``before`` (N,) m."""
        planned = self._job_file.job.path.incremental_depth
        room = self._step_force.deepest(contour) - depth_of(contour) - float(before.mean())
        rise = largest_rise(self._job_file, self._options.largest_step)
        most = np.minimum(np.maximum(before, 0.0) + rise, before + room)
        borne = np.minimum(np.minimum(push, self._options.largest_offset), most)
        if (before + room < push).any():
            remarks.append(step_remark(planned + room, planned, -float(borne.mean())))
        return borne

    def _advance(self, contour: Contour) -> IsfError | None:
        pending = self._memory.pending
        if pending is not None and pending.contour.plan_id != contour.plan_id:
            self._scans.clear()
            self._fault = None
        return self._memory.advance(contour)

    def _move(self, contour: Contour) -> Move | None:
        """First move of the optimised horizon; None between scans. Raises CORRECTION_FAILED, QP_INFEASIBLE."""
        shape, base, target = self._scans.fresh(contour), self._memory.base, self._scans.target
        if shape is None or base is None or target is None:
            return None
        if contour.forming_tool != 1:
            raise IsfError(
                ErrorCode.CORRECTION_FAILED,
                "scans from above steer the upper tool only",
                where=contour_label(contour.index),
                advice="use the method analytic for features formed from below",
            )
        options, formed = self._options, base.contour
        if self._strategy == "tpif":
            # the blank holder moves from contour to contour: only in the frame of the die do their levels descend
            formed, contour, target = contour_over_die(formed), contour_over_die(contour), target_over_die(target)
        polar = PolarContour.of(contour)
        references = np.asarray(options.reference_angles)
        dense = self._strategy == "tpif" or options.distribution == "dense"
        inside = min(float(polar.radius.max()), 40e-3) if self._strategy != "tpif" else OUT_OF_DIE
        radius = forming_radius(self._job_file, contour.forming_tool)
        horizontal = self._strategy != "vertical" and options.distribution != "none"
        angles = references
        if options.step == "per_direction":
            angles = np.concatenate([references, 2 * np.pi * np.arange(PER_DIRECTION) / PER_DIRECTION])
        cut = mpc_state.radial_sections(formed, angles, shape.surface, target, radius, inside)
        level = self._levels(formed, contour, target)
        error = mpc_state.bottom_error(cut, float(level[0]))
        if self._strategy == "tpif":
            near = (references[:, None] + NEARBY).ravel()
            free = self._free(formed, near)
            if not free.any():
                return None  # the die holds all that was formed last: it is right or nothing can be done
            error = np.where(self._free(formed, angles), error, np.nan)
            beside = mpc_state.radial_sections(formed, near, shape.surface, target, radius, inside)
            nearby = np.where(free, mpc_state.bottom_error(beside, float(level[0])), np.nan)
            nearby = nearby.reshape(len(references), -1)
            error[: len(references)] = nearby[np.arange(len(references)), np.argmax(np.isfinite(nearby), axis=1)]
        inputs = self._vertical(cut, level, error)
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
        beyond the last contour (trap H4: a frozen target leaves the last contours behind).
        """
        first = float(np.mean(formed.forming_tip[:, 2]))
        second = float(np.mean(contour.forming_tip[:, 2]))
        left = contour.count - contour.index
        horizon = self._options.horizon or left
        if self._strategy == "tpif":
            horizon = max(horizon, 1)
        else:
            horizon = max(1, min(horizon, left))
        step = self._job_file.job.path.incremental_depth
        level = np.concatenate([[first], second - step * np.arange(horizon)])
        if self._strategy == "tpif":
            return level
        floor = min(float(np.nanmin(target.z)), second)
        return np.asarray(np.maximum(level, floor))

    def _bounds(self, level: Array) -> tuple[float, float]:
        """m, bounds of the signed step depth; in planned steps, so that a lag can be made good."""
        step = max(float(level[0] - level[1]), 0.2 * self._job_file.job.path.incremental_depth)
        return -self._options.largest_step * step, -self._options.smallest_step * step

    def _vertical(self, cut: Sections, level: Array, error: Array) -> Array:
        """(M, H) m, step depths per section."""
        options = self._options
        lower, upper = self._bounds(level)
        if self._strategy == "tpif":
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


NEARBY = np.radians([0.0, *np.outer([3.0, 6.0, 10.0, 15.0, 30.0, 45.0, 60.0, 90.0], [-1.0, 1.0]).ravel()])
"""Where the one bottom point is looked for when the scan has a hole in the reference direction, or the die holds the
sheet there (assumed)."""
OUT_OF_DIE = 30e-3
"""m of section beyond the contact over a die."""


def _radial(contour: Contour) -> tuple[Array, bool]:
    """(N, 2) unit radial directions, and False when the contour has none."""
    try:
        return PolarContour.of(contour).radial, True
    except IsfError:
        return np.zeros((len(contour), 2)), False


def mpc_vertical(job_file: JobFile) -> ModelPredictiveCorrection:
    """Step depth from a section of the shape (Lu 2016, 3.2)."""
    return ModelPredictiveCorrection(job_file, "vertical")


def mpc_two_directional(job_file: JobFile) -> ModelPredictiveCorrection:
    """Step depth and horizontal increments (Lu 2016, 3.3)."""
    return ModelPredictiveCorrection(job_file, "two_directional")


def mpc_tpif(job_file: JobFile) -> ModelPredictiveCorrection:
    """Over a partial die: bottom point and 360 directions (Lu 2016, 3.4)."""
    return ModelPredictiveCorrection(job_file, "tpif")
