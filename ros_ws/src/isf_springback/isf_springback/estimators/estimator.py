"""What a correction method is: an estimator of the springback of the coming contour.

The :class:`~isf_springback.corrector.Corrector` asks it once per contour, in the order of the plan, and turns its
prediction into a correction within all limits::

    estimator.begin(contour, history)
    prediction = estimator.estimate(contour, history)
    ...                                              # limited, sent, formed
    estimator.add_formed(contour, offset, history)   # as it will be formed
    estimator.add_result(corrected, result, history) # forces of the contour
    estimator.add_lift(reading, index)               # where the job lifts the tool and the method uses it
    estimator.add_shape(shape, history)              # where the job scans and the method uses it

Only :meth:`Estimator.estimate` is required; a method of another package derives from :class:`Estimator` and is found by
its entry point (:mod:`isf_springback.methods`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array

from isf_springback.history import History
from isf_springback.limits import LARGEST_CORRECTION

if TYPE_CHECKING:
    from isf_springback.die_room import DieRoom
    from isf_springback.lift_feedback import LiftReading
    from isf_springback.scan_processing import FormedShape


def _empty() -> Array:
    return np.empty(0)


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
    control_point : (M, 3) m, where the model was evaluated
    control_point_springback, control_point_force : (M,) m, (M,) N there, or (0,)
    remarks : what a person should know about this prediction
    fault : what was wrong with a measurement that the method goes on without
    """

    springback: Array
    push: Array | None = None
    deviation: Array = field(default_factory=_empty)
    horizontal: Horizontal | None = None
    expected_error: Array = field(default_factory=_empty)
    control_point: Array = field(default_factory=lambda: np.empty((0, 3)))
    control_point_springback: Array = field(default_factory=_empty)
    control_point_force: Array = field(default_factory=_empty)
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
    by_force : the push is held to what the force of the machine bears (:mod:`isf_springback.step_force`)
    at_floor : where a contour reaches a floor that is passed over it is pushed no more than the wall before it
    die : room beside a die that the tools must keep to
    """

    pulls_back: bool = False
    largest: float = LARGEST_CORRECTION
    rise: float = np.inf
    by_force: bool = False
    at_floor: bool = True
    die: DieRoom | None = None


class Estimator(ABC):
    """A correction method for the job ``job_file``; its instance serves one part at a time."""

    name: str
    """Name of the method, as in the job."""
    needs_scans: ClassVar[bool] = False
    """True when the method corrects nothing without scans between contours."""
    uses_lifts: bool = False
    """True when :meth:`add_lift` is worth waiting for."""
    uses_scans: bool = False
    """True when :meth:`add_shape` is worth waiting for."""
    over_die: bool = False
    """True when the method takes shapes formed over a die, in the frame of the die."""

    def __init__(self, job_file: JobFile) -> None:
        self.job_file = job_file

    def begin(self, contour: Contour, history: History) -> None:  # noqa: B027 - a default
        """``contour`` is next; ``history`` has advanced to it. Called again when a contour is asked for again."""

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

    def add_formed(self, contour: Contour, offset: Array, history: History) -> None:  # noqa: B027
        """``contour`` is formed with ``offset`` (N, 3) m, by this method's prediction or by another method's."""

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

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """Nothing is asked for."""
        return Prediction(np.empty(0), push=np.zeros(len(contour)))
