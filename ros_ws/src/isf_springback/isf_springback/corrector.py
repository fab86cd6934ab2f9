"""The corrector: turns what a method predicts into a correction that every contour can be formed with.

It owns what all methods have in common: the steps from contour to contour, passes over the floor, the bound by the
force of the machine, the limits, the room beside a die, and the message. A method only predicts
(:mod:`isf_springback.estimators.estimator`). Per contour::

    correction = corrector.correct(contour)
    corrected = apply(contour, correction)      # formed by the machine
    corrector.add_result(corrected, result)     # what was measured meanwhile
    corrector.add_lift(reading, index)          # where the job asks for tool lifts
    corrector.add_scan(points, index)           # where the job asks for scans

**Floor.** A pass over the floor (planner, ``path.floor_step``) needs less force than the contour on the wall before it,
by a share that nobody knows before; a floor pressed too deep cannot be raised. So the contour that reaches the floor is
pressed no more than the wall, the first pass less, and every further one as deep as the nearest pass that the newest
scan has seen, plus what that shows is left there: more where the floor still stands up, less where it lies too deep.
Without a scan it is as deep as the nearest pass before it. A method that replays a part replays its passes.

**Force.** The force of forming grows with the step between two contours as they are formed, by an exponent that no
controller knows of its machine. Bounds of it are enough: a step grows as if the larger one held, and shrinks as if the
smaller one did. Half of what else the force rose by is taken to come again (Ren 2018, 4.3.1). Every contour is measured
again, so that an error of these bounds lasts one contour. Steps, m, are those of the commanded tips along the push,
corrections included, over a die in the frame of the die.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np
from isf_core.contour import (
    Contour,
    ContourCorrection,
    ContourResult,
    contour_label,
    makes_floor,
    over_floor,
)
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Mask
from scipy.ndimage import distance_transform_edt, median_filter

from isf_springback.die_room import within_room
from isf_springback.estimators.estimator import Bounds, Estimator, FormedContour, History, Prediction, Wall, wall_of
from isf_springback.lift_feedback import LiftReading
from isf_springback.loop_path import (
    HORIZONTAL_SLOPE,
    NEGLIGIBLE,
    PUSH_SLOPE,
    Limits,
    change_per_contour,
    fade_horizontal,
    forming_radii,
    limit_along,
    nearest_points,
)
from isf_springback.scan.feedback import ScanMemory, contour_over_die
from isf_springback.scan.sections import heights_at

DIE_REMARK = "the die leaves no room for more correction where the contour works over it"
SUPPORT_REMARK = "the support tool under the blank leaves no room for more correction"


@dataclass(frozen=True)
class _Push:
    """Push of one contour: ``asked`` for and ``given`` (N,) m, where a limit changed it, and what to tell of it."""

    asked: Array
    given: Array
    limited: Mask
    over_floor: bool
    remarks: tuple[str, ...]


class Corrector:
    """Corrects one part after the other, contour by contour, by the predictions of one method.

    Attributes
    ----------
    estimator : the method
    history : what was applied to the part so far, for reading
    support_stays : the support tool is under the blank, where no correction moves it (:func:`apply`)
    """

    def __init__(self, estimator: Estimator, job_file: JobFile) -> None:
        self.estimator = estimator
        self.support_stays = job_file.job.support_stays
        self._job_file = job_file
        self.history = History(ScanMemory(job_file, over_die=estimator.over_die))
        self._floors: dict[Wall, FloorFeedback] = defaultdict(FloorFeedback)
        self._forces: dict[Wall, StepForce] = defaultdict(partial(StepForce, job_file))
        self._floor, self._force = FloorFeedback(), StepForce(job_file)  # of the wall in work
        self._radius = forming_radii(job_file)
        self._change = change_per_contour(job_file)

    @property
    def name(self) -> str:
        """Name of the method."""
        return self.estimator.name

    @property
    def uses_lifts(self) -> bool:
        """True when the method learns from tool lifts."""
        return self.estimator.uses_lifts

    @property
    def uses_scans(self) -> bool:
        """True when the method learns from scans."""
        return self.estimator.uses_scans

    def set_target(self, target: HeightMap, preforms: Sequence[HeightMap] = ()) -> None:
        """The shape that is wanted, and those that the stages before the last end with, before the first contour."""
        self.history.scans.set_target(target, preforms)

    def correct(self, contour: Contour) -> ContourCorrection:
        """Correction of the next contour; never raises for missing or bad measurements.

        Where the method lacks something, the last good correction is kept and the code tells what. CORRECTION_LIMITED:
        the largest correction was reached.

        Raises
        ------
        IsfError : CONTOUR_REJECTED, the contour itself is malformed; what the method's ``begin`` raises: it cannot
            serve this plan
        """
        started = time.perf_counter()
        contour.validate()
        fault = self._begin(contour)
        prediction: Prediction | None = None
        if fault is None:
            try:
                prediction = self.estimator.estimate(contour, self.history)
                fault = prediction.fault
            except IsfError as error:
                fault = error
        bounds = self.estimator.bounds(contour, self.history)
        last = self.history.last(contour)
        push = self._push(contour, last.push, prediction, bounds)
        horizontal, limited, far = self._horizontal(contour, last.offset[:, :2], prediction, bounds)
        up = -contour.push_sign
        offset = np.column_stack([horizontal, -up * push.given])
        limited |= push.limited
        remarks = push.remarks if prediction is None else (*prediction.remarks, *push.remarks)
        if bounds.die is not None:
            offset, held = within_room(bounds.die, contour_over_die(contour), offset)
            limited |= held
            remarks += (DIE_REMARK,) if held.any() else ()
        largest = max(float(np.abs(push.asked).max()), far)
        if fault is None and largest > bounds.largest:
            fault = _too_large(contour, largest, bounds.largest)
        self._add_formed(FormedContour(contour, offset, -up * offset[:, 2], push.over_floor))
        spent = time.perf_counter() - started
        return _message(self.name, contour, up, prediction, push, offset, limited, fault, remarks, spent)

    def follow(self, contour: Contour, correction: ContourCorrection, *, predict: bool = False) -> None:
        """Take note that another method corrected ``contour``, to take over later without a jump.

        Called in place of :meth:`correct`, for every contour in order, each followed by its measurements. ``predict``:
        the method predicts all the same, as it did where it was the same one with other parameters that corrected; some
        keep what they computed for the contours to come.
        """
        fault = self._begin(contour)
        if predict and fault is None:
            with suppress(IsfError):  # what it lacks was told by the one that corrected
                self.estimator.estimate(contour, self.history)
        before = None if self.history.base is None else self.history.base.contour
        passed = self._floor.push(contour, before, self.history.last(contour).push) is not None
        offset = np.array(correction.offset, dtype=np.float64)
        self._add_formed(FormedContour(contour, offset, contour.push_sign * offset[:, 2], passed))

    def add_result(self, contour: Contour, result: ContourResult) -> None:
        """What was measured while ``contour`` (as corrected) was formed; never raises."""
        self.estimator.add_result(contour, result, self.history)
        self._forces[wall_of(contour)].add(contour, result)

    def add_lift(self, reading: LiftReading | None, index: int) -> None:
        """What the tool lift after contour ``index`` measured, None when it failed; never raises."""
        if self.uses_lifts:
            self.estimator.add_lift(reading, index)

    def add_scan(self, points: Array, index: int) -> None:
        """Points (P, 3) m of the sheet's upper surface after contour ``index``; never raises."""
        if not self.uses_scans:
            return
        history, formed = self.history, self.history.current
        if formed is not None and formed.contour.forming_tool != 1:
            self.estimator.add_shape(None, history)  # a scan from above does not show what is formed from below
            return
        shape = history.scans.take(points, None if formed is None else formed.contour, index)
        if shape is not None and formed is not None and history.scans.target is not None:
            history.add_scan()
            for wall, floor in self._floors.items():
                if wall[1:] == self.history.wall[1:]:
                    floor.update(shape.surface, history.scans.target)
        self.estimator.add_shape(shape, history)

    # -- inside --------------------------------------------------------------------------------------

    def _begin(self, contour: Contour) -> IsfError | None:
        """Advance to ``contour``; the error when it is out of order."""
        current = self.history.current
        if current is not None and current.contour.plan_id != contour.plan_id:
            self._floors.clear()
            self._forces.clear()
        fault = self.history.advance(contour)
        self._floor, self._force = self._floors[self.history.wall], self._forces[self.history.wall]
        self.estimator.begin(contour, self.history)
        return fault

    def _add_formed(self, formed: FormedContour) -> None:
        self.history.current = formed
        if formed.over_floor:
            self._floor.add(formed.contour, formed.push)
        self.estimator.add_formed(formed, self.history)

    def _push(self, contour: Contour, last: Array, prediction: Prediction | None, bounds: Bounds) -> _Push:
        """Push of ``contour`` after the ``last`` (N,) m: over a floor what the floor needs, else, and of a method that
        replays, what the method asks for, within all bounds."""
        base = self.history.base
        pressed = self._floor.push(contour, None if base is None else base.contour, last)
        asked = last if prediction is None else self._asked(prediction)
        if pressed is None:
            asked = at_edge(contour, asked, last) if bounds.at_floor else asked
        elif prediction is None or not bounds.replays_floor:
            asked = pressed
        # lifted tools jump nowhere; a floor may need far less push than the wall before it
        free = base is None or pressed is not None
        admitted, remarks = self._bounded(contour, asked, last, bounds, forced=pressed is None)
        limits = Limits(
            slope=PUSH_SLOPE,
            average=2.0 * self._radius[contour.forming_tool],
            change=bounds.largest if free else self._change,
            largest=bounds.largest,
            # after a method that has pulled back it comes forward again by the change per contour
            smallest=-np.inf if bounds.pulls_back else min(0.0, float(last.min())),
        )
        # tools that come back to a feature begin an open path somewhere else than where they left it
        start = None if base is None or base.contour.index != contour.index - 1 else float(base.push[-1])
        if not (self.support_stays and contour.has_support):
            given, limited = limit_along(contour, admitted, limits, last, start)
        else:
            room = room_to_support(contour, self._job_file.job)
            remarks += (SUPPORT_REMARK,) if bool((admitted - room > NEGLIGIBLE).any()) else ()
            admitted = np.minimum(admitted, room)
            given, limited = limit_along(contour, admitted, limits, last, start)
            given = np.minimum(given, room)
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
        rise = bounds.rise if self.history.base is not None else np.inf
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
        self, contour: Contour, last: Array, prediction: Prediction | None, bounds: Bounds
    ) -> tuple[Array, Mask, float]:
        """(N, 2) m horizontal offset after the ``last`` (N, 2) m, where a limit changed it, and the largest value asked
        for, m.

        Without a prediction the last one is kept; a method without horizontal offsets lets that of another one fade.
        """
        none = np.zeros(len(last), dtype=bool)
        if prediction is None:
            return last, none, 0.0
        if prediction.horizontal is None:
            wanted, limited, largest = np.zeros(last.shape), none, 0.0
        else:
            direction, value = prediction.horizontal.direction, prediction.horizontal.value
            along = np.sum(last * direction, axis=1)
            asked = along if value is None else value
            # averaged over half the way of the push, so that corners stay
            radius = self._radius[contour.forming_tool]
            limits = Limits(HORIZONTAL_SLOPE, radius, self._change, bounds.largest, -bounds.largest)
            given, limited = limit_along(contour, asked, limits, along)
            wanted, largest = given[:, None] * direction, float(np.abs(asked).max())
        if self.history.base is None or (prediction.horizontal is None and not last.any()):
            return wanted, limited, largest
        faded, far = fade_horizontal(wanted, last, self._change)
        return faded, limited | far, largest


def apply(contour: Contour, correction: ContourCorrection, *, support_stays: bool = False) -> Contour:
    """The contour as it is to be formed: contact and both tips moved alike, so the gap of the tools stays.

    ``support_stays``: the support tool is under the blank (:attr:`isf_core.files.job.Job.support_stays`). It holds the
    sheet at the opening in place, as a backing plate does, and would press it down where the correction moved it, too.

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
    return contour.shifted(correction.offset, support=not support_stays)


def room_to_support(contour: Contour, job: Job) -> Array:
    """(N,) m, push of the forming tool alone that leaves the thickness of the blank between the balls of both tools.

    The sheet is thinner there, by how much nobody knows for sure. Infinite where the balls pass beside each other.
    """
    upper, lower = job.tool_1.ball_radius, 0.0 if job.tool_2 is None else job.tool_2.ball_radius
    up = -contour.push_sign
    apart = contour.forming_tip - contour.support_tip + [0.0, 0.0, up * (upper + lower)]
    least = (upper + lower + job.sheet.thickness) ** 2 - (apart[:, :2] ** 2).sum(axis=1)
    room = np.maximum(up * apart[:, 2] - np.sqrt(np.maximum(least, 0.0)), 0.0)
    return np.where(least > 0.0, room, np.inf)


def _too_large(contour: Contour, asked: float, largest: float) -> IsfError:
    return IsfError(
        ErrorCode.CORRECTION_LIMITED,
        f"{1e3 * asked:.1f} mm requested, the largest correction allowed is {1e3 * largest:.1f} mm",
        where=contour_label(contour.index),
        advice="check measured force, scanner and clamp, and the sheet thickness of the job",
    )


def _message(
    method: str,
    contour: Contour,
    up: float,
    prediction: Prediction | None,
    push: _Push,
    offset: Array,
    limited: Mask,
    fault: IsfError | None,
    remarks: tuple[str, ...],
    spent: float,
) -> ContourCorrection:
    """What is published: springback along z, by the sign ``up`` of the direction against the push."""
    said = Prediction(np.empty(0)) if prediction is None else prediction
    remaining = np.empty(0)
    cut_off = up * (push.asked - push.given)
    if len(said.expected_error):
        remaining = said.expected_error + cut_off if said.beside_limits else said.expected_error
    elif len(said.springback):
        remaining = cut_off
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


FIRST_SHARE = 0.6
"""Push of the first pass over the push on the wall before it (assumed, on the careful side)."""
NEXT_ROUND = 0.5
"""Share of what is left that a further pass over the same ring presses deeper (assumed): the rings beside it lower it
too, and scans scatter. With all of it the base of lu_cone came out up to 0.17 mm off in variants 2 and 3, 0.16 and
0.14 mm with half."""
SAME_PLACE = 0.2e-3
"""m between points of passes that follow the same ring."""
WIDTH = 5
"""mm, places over which an error is read (median)."""


def at_edge(contour: Contour, wanted: Array, pushed: Array) -> Array:
    """(N,) m, push on ``contour`` of ``wanted`` (N,) m: where it reaches a floor that is passed over, no more than
    ``pushed`` (N,) m on the contour before."""
    if not (contour.floor_passes and makes_floor(contour)):
        return wanted
    return np.minimum(wanted, np.maximum(pushed, 0.0))


@dataclass(frozen=True)
class _Passes:
    """Passes over one floor: ``place`` (K, 2) m of their tips, and their ``push`` (K,) m."""

    place: Array
    push: Array

    def near(self, contour: Contour) -> tuple[Array, Array]:
        """Place (N, 2) m and push (N,) m nearest to every tip of ``contour``."""
        nearest = nearest_points(contour.forming_tip[:, :2], self.place)
        return self.place[nearest], self.push[nearest]


NO_PASSES = _Passes(np.empty((0, 2)), np.empty(0))


class FloorFeedback:
    """Pushes on the floor that the wall of one feature ends in, and the error of the floor by the newest scan."""

    def __init__(self) -> None:
        self._formed = NO_PASSES
        self._pending: tuple[Contour, Array] | None = None
        self._scanned = NO_PASSES
        self._error: HeightMap | None = None

    def passes(self, contour: Contour) -> bool:
        """True when ``contour`` was the last pass over this floor."""
        known = self._pending
        return known is not None and (known[0].plan_id, known[0].index) == (contour.plan_id, contour.index)

    def update(self, surface: HeightMap, target: HeightMap) -> None:
        """The shape after the last contour; before the first pass it says nothing of the floor."""
        if self._pending is None and not len(self._formed.place):
            return
        places = np.stack(np.meshgrid(target.x, target.y), axis=-1)
        error = heights_at(surface, places) - target.z
        unknown = ~np.isfinite(error)
        if not unknown.all():  # in holes of the scan: as beside them
            row, column = distance_transform_edt(unknown, return_distances=False, return_indices=True)
            self._error = HeightMap(target.x, target.y, median_filter(error[row, column], WIDTH))
            self._scanned = self._with_pending()

    def push(self, contour: Contour, before: Contour | None, pushed: Array) -> Array | None:
        """(N,) m, push wanted on ``contour``; None when it is no pass over the floor.

        ``pushed`` (N,) m, push of the contour ``before`` it, seen from ``contour``.
        """
        if before is None or not over_floor(contour, before):
            return None
        if self.passes(before):
            self._formed = self._with_pending()
        elif not self.passes(contour):  # asked again, the passes before it are those known
            self._formed = self._scanned = NO_PASSES
        if not len(self._formed.place):
            return FIRST_SHARE * np.maximum(pushed, 0.0)
        if self._error is None or not len(self._scanned.place):
            return np.maximum(self._formed.near(contour)[1], 0.0)
        # what a scan shows to be left is left by the pushes that it has seen: later ones have had it added already
        place, push = self._scanned.near(contour)
        left = heights_at(self._error, place)
        again = np.linalg.norm(place - contour.forming_tip[:, :2], axis=1) <= SAME_PLACE
        left = np.where(again & (left > 0.0), NEXT_ROUND * left, left)
        return np.maximum(push + left, 0.0)

    def add(self, contour: Contour, push: Array) -> None:
        """The pass ``contour`` is formed with ``push`` (N,) m."""
        self._pending = contour, push

    def _with_pending(self) -> _Passes:
        """The passes with the last one, which replaces those before it at its place."""
        if self._pending is None:
            return self._formed
        contour, push = self._pending
        place, before = contour.forming_tip[:, :2], self._formed
        if not len(before.place):
            return _Passes(place, push)
        apart = np.linalg.norm(place[nearest_points(before.place, place)] - before.place, axis=1)
        kept = apart > SAME_PLACE
        return _Passes(np.vstack([before.place[kept], place]), np.concatenate([before.push[kept], push]))


LARGEST_EXPONENT = 0.5
"""Growth of the force with the step if all of it were the arc that the ball wets, which grows with its root (assumed as
the upper bound; Praveen 2020, eq. 2: acos(1 - step / radius))."""

SMALLEST_EXPONENT = 0.15
"""Assumed as the lower bound: somewhat less than the published one, 0.18 (scallop^0.09, Aerens et al. 2009)."""

WANTED_SHARE = 0.95
"""Largest force that a step is planned for, as a share of the limit (assumed): of a load cell with 1 % noise the
largest of 30,000 ticks lies 4 % over the mean, the largest of the 400 points of a contour 3 %; with the forecast off
by 1 %, and corners, 0.96 let strong sheets reach the limit."""

PLANNED_SHARE = 0.965
"""The same for a step that is no larger than planned (assumed): to make it smaller leaves the part too high, so that
the plan may come nearer to the limit than a correction."""

SMALLEST_STEP = 0.2
"""Planned steps that a contour goes deeper at least, whatever the force (assumed): the tool keeps forming."""

CALMEST = 0.1
"""Planned steps below which a step says nothing of the force: the tool was led back."""


@dataclass(frozen=True)
class FormedStep:
    """One contour as it was formed.

    Attributes
    ----------
    depth : m, mean tip along the push ; step : m, deeper than the contour before
    mean : N, axial force on the forming tool, mean around the contour
    share : largest force as a share of the limit of its axis
    """

    depth: float
    step: float
    mean: float
    share: float


class StepForce:
    """Remembers the last two contours of one wall; see the module text."""

    def __init__(self, job_file: JobFile) -> None:
        self._job_file = job_file
        self._steps: list[FormedStep] = []

    def add(self, contour: Contour, result: ContourResult) -> None:
        """What was measured while ``contour``, as corrected, was formed; a result without forces is left out."""
        share = force_share(result, self._job_file)
        axial = np.abs(np.asarray(result.forming_force, dtype=np.float64)[:, 2]) if share > 0.0 else np.empty(0)
        if not result.completed or not np.isfinite(axial).any():
            self._steps = []
            return
        depth = depth_of(contour)
        planned = self._job_file.job.path.incremental_depth
        step = depth - self._steps[-1].depth if self._steps else planned
        formed = FormedStep(depth, max(step, CALMEST * planned), float(np.nanmean(axial)), share)
        self._steps = [*self._steps[-1:], formed]

    def deepest(self, contour: Contour) -> float:
        """m, largest depth of ``contour``, mean tip along the push; infinite where nothing was measured before it."""
        if not self._steps:
            return float("inf")
        planned = self._job_file.job.path.incremental_depth
        step = largest_step(self._steps)
        if step < planned:
            step = min(planned, largest_step(self._steps, PLANNED_SHARE))
        return self._steps[-1].depth + max(step, SMALLEST_STEP * planned)


def force_share(result: ContourResult, job_file: JobFile) -> float:
    """Largest measured force of the forming tool as a share of the limit of its axis: of machine or load cell.

    0 where nothing finite was measured.
    """
    force = np.abs(np.asarray(result.forming_force, dtype=np.float64))
    if force.ndim != 2 or force.shape[-1] != 3 or not np.isfinite(force).any():
        return 0.0
    limit = np.minimum(job_file.rig.limits.force, job_file.rig.load_cell.force_range)
    return float(np.nanmax(np.where(np.isfinite(force), force, 0.0) / limit))


def depth_of(contour: Contour) -> float:
    """m, mean tip of ``contour`` along the push, over a die in the frame of the die."""
    return contour.push_sign * (float(np.mean(contour.forming_tip[:, 2])) + contour.holder_height)


def largest_step(steps: list[FormedStep], wanted: float = WANTED_SHARE) -> float:
    """m, after the formed ``steps`` (the last one or two count), for ``wanted`` share of the limit."""
    last = steps[-1]
    growth = 1.0
    if len(steps) > 1:
        before = steps[-2]
        ratio = last.step / before.step
        # the force of the contour before, had it gone as deep; the forecast is the published 1.5 F(i-1) - 0.5 F(i-2)
        alike = before.mean * min(ratio**exponent for exponent in (SMALLEST_EXPONENT, LARGEST_EXPONENT))
        growth = max(1.0, 1.5 - 0.5 * alike / max(last.mean, 1e-9))
    room = wanted / (last.share * growth)
    return float(last.step * room ** (1.0 / (LARGEST_EXPONENT if room >= 1.0 else SMALLEST_EXPONENT)))


def step_remark(step: float, planned: float, above: float) -> str:
    """What a person should know when the force held a correction back; ``above`` m over the plan the tool then is."""
    allowed = f"the force of the machine allows a step of {1e3 * max(step, 0.0):.2f} mm here"
    if step >= planned:
        return f"{allowed}: the correction grows slower; use a smaller tool or depth step"
    return (
        f"{allowed}, {1e3 * planned:.2f} mm are planned: the tool goes {1e3 * abs(above):.2f} mm "
        f"{'above' if above > 0.0 else 'below'} the plan; use a smaller tool or depth step"
    )
