"""What a correction method is: an estimator of the springback of the coming contour, from the history of the part.

The :class:`~isf_springback.corrector.Corrector` asks it once per contour, in the order of the plan, and turns its
prediction into a correction within all limits::

    estimator.begin(contour, history)
    prediction = estimator.estimate(contour, history)
    ...                                              # limited, sent, formed
    estimator.add_formed(formed, history)            # as it will be formed
    estimator.add_result(corrected, result, history) # forces of the contour
    estimator.add_lift(reading, index)               # where the job lifts the tool and the method uses it
    estimator.add_shape(shape, history)              # where the job scans and the method uses it

Only :meth:`Estimator.estimate` is required; a method of another package derives from :class:`Estimator` and is found by
its entry point (:mod:`isf_springback.methods`).

Every correction leaves the last one by a bounded step, whatever method gave either, so that no change of method,
missing force or wrong order makes the tools jump. Where the tools come down from the air there is nothing to step off
from: :class:`History` knows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from isf_core.contour import Contour, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array

from isf_springback.loop_path import LARGEST_CORRECTION, nearest_points
from isf_springback.scan.feedback import ScanMemory

if TYPE_CHECKING:
    from isf_springback.die_room import DieRoom
    from isf_springback.lift_feedback import LiftReading
    from isf_springback.scan import FormedShape


class Wall(NamedTuple):
    """What contours of one plan form together, each the next part of it; others may come in between, whose correction
    and forces say nothing of it."""

    feature: int
    stage: int
    forming_tool: int


def wall_of(contour: Contour) -> Wall:
    """The wall that ``contour`` is a part of."""
    return Wall(contour.feature, contour.stage, contour.forming_tool)


@dataclass(frozen=True)
class FormedContour:
    """A contour as planned, and how it was formed.

    Attributes
    ----------
    offset : (N, 3) m, correction of contact and tips
    push : (N,) m, its part along the push direction of the forming tool
    over_floor : the contour passed over a floor that was formed before
    """

    contour: Contour
    offset: Array
    push: Array
    over_floor: bool = False


@dataclass(frozen=True)
class LastCorrection:
    """The correction that a contour of N points continues: ``offset`` (N, 3) m, ``push`` (N,) m."""

    offset: Array
    push: Array


class History:
    """The contour in work (``current``) and the one that its correction continues (``base``), with their offsets.

    Before the first contour the tools are lifted, and so when they swap, travel to another feature or begin a further
    stage: there is no base and no change to limit. The depth that they go to at once is bounded by the largest
    correction alone. Tools that come back to a feature of the same stage continue the contour that they left it with,
    and two tools the stage before: the support tool lifts a formed sheet until the forming tool carries, which without
    its push would spoil the part (a finishing pass on the fast sheet: from 0.39 to 1.33 mm rms).

    Attributes
    ----------
    base, current : None where there is none
    wall, of_wall : the wall in work, and the indices of its contours so far, the one in work last
    walls : such indices of every wall
    shown : what the newest scan tells of, by wall: the last contour of all that were formed from the same side, in the
        same stage, since the scan before; the others say nothing new of the process
    scans : the target, and the shapes measured between contours
    """

    def __init__(self, scans: ScanMemory) -> None:
        self.scans = scans
        self.base: FormedContour | None = None
        self.current: FormedContour | None = None
        self.wall = Wall(0, 0, 1)
        self.of_wall: list[int] = []
        self._left: dict[tuple[int, int], FormedContour] = {}
        self.walls: dict[Wall, list[int]] = {}
        self.shown: dict[Wall, FormedContour] = {}
        self._formed: dict[Wall, FormedContour] = {}
        self._scanned = -1

    def advance(self, contour: Contour) -> IsfError | None:
        """Prepare for ``contour``; returns CONTOUR_OUT_OF_ORDER when it does not follow the last one.

        Asking again for the same contour starts from the same base; a new plan starts anew.
        """
        current = self.current
        if contour.stage != self.scans.stage:
            self.scans.work_on(contour.stage)
        if current is None or current.contour.plan_id != contour.plan_id:
            if current is not None:
                self.scans.clear()
            self.base = self.current = None
            self._left, self.walls, self.shown, self._formed, self._scanned = {}, {}, {}, {}, -1
            self._count(contour)
            return None
        last = current.contour
        if contour.index == last.index:
            return None
        self._formed[self.wall] = current
        self._count(contour)
        self._left[last.feature, last.stage] = current
        # lifted tools need not go on from the push that they had elsewhere
        base = self._left.get((contour.feature, contour.stage)) if contour.retract else current
        if base is None and contour.has_support:
            base = self._left.get((contour.feature, contour.stage - 1))
        self.base = None if last.forming_tool != contour.forming_tool else base
        if contour.index == last.index + 1:
            return None
        return IsfError(
            ErrorCode.CONTOUR_OUT_OF_ORDER,
            f"{contour_label(contour.index)} came after {contour_label(last.index)}",
            where=f"plan {contour.plan_id}",
            advice="contours must come in the order of the plan; the last good correction is kept",
        )

    def add_scan(self) -> None:
        """A scan that can be used was made after the contour in work."""
        assert self.current is not None  # a scan is one of a contour
        self._formed[self.wall] = self.current
        self.shown = {
            wall: formed
            for wall, formed in self._formed.items()
            if wall[1:] == self.wall[1:] and (wall == self.wall or formed.contour.index > self._scanned)
        }
        self._scanned = self.current.contour.index

    def _count(self, contour: Contour) -> None:
        self.wall = wall_of(contour)
        before = self.walls.get(self.wall, [])
        self.of_wall = [*(index for index in before if index < contour.index), contour.index]
        self.walls[self.wall] = self.of_wall

    def last(self, contour: Contour) -> LastCorrection:
        """The correction of the base at the nearest place in plan view of every point of ``contour``; zero when there
        is no base."""
        base = self.base
        if base is None:
            return LastCorrection(np.zeros((len(contour), 3)), np.zeros(len(contour)))
        nearest = nearest_points(contour.forming_tip[:, :2], base.contour.forming_tip[:, :2])
        return LastCorrection(base.offset[nearest], base.push[nearest])


@dataclass(frozen=True)
class Horizontal:
    """Horizontal offset along given directions.

    Attributes
    ----------
    direction : (N, 2) unit vectors, zero where there is none
    value : (N,) m along them; None keeps the last one
    """

    direction: Array
    value: Array | None


@dataclass(frozen=True)
class Prediction:
    """What an estimator says of one contour: N path points, M control points; positive along the push direction.

    Attributes
    ----------
    springback : (N,) m, expected elastic recovery, which the correction pushes against; (0,) where the method does not
        predict it and gives ``push`` alone
    push : (N,) m, push that is asked for; None: the springback times the job's gain
    deviation : (N,) m, standard deviation of the springback, or (0,)
    horizontal : offset in plan view; None: none
    expected_error : (N,) m along +z after this contour, where the method predicts it; (0,): what the limits leave
    beside_limits : what the limits leave is not in ``expected_error`` and comes on top
    control_point : (M, 3) m, where the model was evaluated
    control_point_springback, control_point_force : (M,) m, (M,) N there, or (0,)
    remarks : what a person should know about this prediction
    fault : what was wrong with a measurement that the method goes on without
    """

    springback: Array
    push: Array | None = None
    deviation: Array = field(default_factory=partial(np.empty, 0))
    horizontal: Horizontal | None = None
    expected_error: Array = field(default_factory=partial(np.empty, 0))
    beside_limits: bool = False
    control_point: Array = field(default_factory=partial(np.empty, (0, 3)))
    control_point_springback: Array = field(default_factory=partial(np.empty, 0))
    control_point_force: Array = field(default_factory=partial(np.empty, 0))
    remarks: tuple[str, ...] = ()
    fault: IsfError | None = None


@dataclass(frozen=True)
class Bounds:
    """How far the corrector follows an estimator at one contour, beside the limits of every correction.

    Attributes
    ----------
    pulls_back : the tool may be led back from the planned path (the method sees what was formed too deep)
    largest : m, largest correction
    rise : m, by which the push may grow over the one on the contour before
    by_force : the push is held to what the force of the machine bears (:mod:`isf_springback.corrector`)
    at_floor : where a contour reaches a floor that is passed over it is pushed no more than the wall before it
    replays_floor : passes over a floor are pushed as the method asks for, which knows what they came to on a part
        before; else the corrector presses them (:mod:`isf_springback.corrector`)
    die : room beside a die that the tools must keep to
    """

    pulls_back: bool = False
    largest: float = LARGEST_CORRECTION
    rise: float = np.inf
    by_force: bool = False
    at_floor: bool = True
    replays_floor: bool = False
    die: DieRoom | None = None


class Estimator(ABC):
    """A correction method for the job ``job_file``; its instance serves one part at a time."""

    name: str
    """Name of the method, as in the job."""
    needs_scans: ClassVar[bool] = False
    """True when the method corrects nothing without scans between contours."""
    open_loop: ClassVar[bool] = False
    """True when the correction of every contour is known before anything is measured on the part: what is measured
    then may add to it, but it is a correction without that as well."""
    uses_lifts: bool = False
    """True when :meth:`add_lift` is worth waiting for."""
    uses_scans: bool = False
    """True when :meth:`add_shape` is worth waiting for."""
    over_die: bool = False
    """True when the method takes shapes formed over a die, in the frame of the die."""

    def __init__(self, job_file: JobFile) -> None:
        self.job_file = job_file

    def begin(self, contour: Contour, history: History) -> None:  # noqa: B027 - a default
        """``contour`` is next; ``history`` has advanced to it. Called again when a contour is asked for again.

        Raises
        ------
        IsfError : the method cannot serve this plan; the contour is refused
        """

    @abstractmethod
    def estimate(self, contour: Contour, history: History) -> Prediction:
        """Prediction for ``contour``, after :meth:`begin`.

        Raises
        ------
        IsfError : what the method lacks; the contour is then formed with the last good correction and tells it
        """

    def bounds(self, contour: Contour, history: History) -> Bounds:
        """How far the corrector follows at ``contour``."""
        return Bounds()

    def add_formed(self, formed: FormedContour, history: History) -> None:  # noqa: B027
        """The contour is formed so, by this method's prediction or by another method's."""

    def add_result(self, contour: Contour, result: ContourResult, history: History) -> None:  # noqa: B027
        """What was measured while ``contour``, as corrected, was formed; never raises."""

    def add_lift(self, reading: LiftReading | None, index: int) -> None:  # noqa: B027
        """The tool lift after contour ``index``, None when it failed; never raises."""

    def add_shape(self, shape: FormedShape | None, history: History) -> None:  # noqa: B027
        """The shape measured after ``history.current``; None: the scan was refused (``history.scans.fault``), or does
        not show a contour formed from below. Never raises."""


class NoCorrection(Estimator):
    """Method "none": contours pass unchanged; after a change of method the old correction fades out."""

    name = "none"
    open_loop = True

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """Nothing is asked for."""
        return Prediction(np.empty(0), push=np.zeros(len(contour)))
