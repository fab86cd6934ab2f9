"""A springback model of the sheet under the measured axial force, scaled by tool lifts: what "analytic" and "elastic"
have in common, and what "fused" corrects by scans."""

from __future__ import annotations

from abc import abstractmethod

from isf_core.contour import Contour, ContourResult, contour_label
from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array

from isf_springback.estimators.axial_force import AxialForce
from isf_springback.estimators.estimator import Estimator, Prediction
from isf_springback.history import History
from isf_springback.law_scale import LawScale
from isf_springback.lift_feedback import LiftReading
from isf_springback.loop_path import nearest_points


class SheetModel(Estimator):
    """Springback as a function of the axial force.

    Attributes
    ----------
    force : measured loads and their forecast
    scale : factor on the computed springback, from tool lifts
    """

    uses_lifts = True

    def __init__(self, job_file: JobFile, force: AxialForce) -> None:
        super().__init__(job_file)
        self.force = force
        self.scale = LawScale()
        self._contour: Contour | None = None
        self._lift_remark = ""

    @abstractmethod
    def predict(self, contour: Contour) -> Prediction:
        """Springback of ``contour`` under the force expected, or, once it is formed, measured on it.

        Raises
        ------
        IsfError : what the model lacks
        """

    @abstractmethod
    def springback_under(self, contour: Contour, point: int, force: Array) -> Array:
        """(K,) m, springback at path point ``point`` under ``force`` (K,) N, before the scale; raises as predict."""

    def begin(self, contour: Contour, history: History) -> None:
        """As the base class."""
        before = self._contour
        if before is not None and before.plan_id != contour.plan_id:
            self.scale.clear()
            self._lift_remark = ""
        self.force.begin(contour, before)
        self._contour = contour

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """As the base class; raises NO_FORCE_HISTORY, CORRECTION_FAILED, CONTOUR_OUT_OF_ORDER, as :meth:`predict`."""
        self.force.check()
        return self.predict(contour)

    def add_result(self, contour: Contour, result: ContourResult, history: History) -> None:
        """As the base class."""
        self.force.add(contour, result, history)

    def add_lift(self, reading: LiftReading | None, index: int) -> None:
        """Scale the law by the tool lift after contour ``index``; a useless one is reported by a remark."""
        contour = self._contour
        if reading is None or contour is None or contour.index != index:
            self._lift_remark = f"the tool lift after {contour_label(index)} told nothing; the model stays as it was"
            return
        point = int(nearest_points(reading.place[None, :2], contour.forming_tip[:, :2])[0])
        try:
            law = self.springback_under(contour, point, reading.force)
        except IsfError as error:
            self._lift_remark = f"the tool lift after {contour_label(index)} is not used: {error.message}"
            return
        self.scale.add(contour.contact[point], reading, law)
        self._lift_remark = self.scale.remark()

    def lift_remarks(self) -> tuple[str, ...]:
        """What the newest tool lift says, for a person."""
        return (self._lift_remark,) if self._lift_remark else ()

    def lifted_share(self, place: Array) -> Array:
        """(M,) factor on the springback at ``place`` (M, 3) m by tool lifts, at the last measured forces; 1: none."""
        return self.scale.at(place, self.force.last_at(place[:, :2])).factor

    def hindsight(self) -> Array | None:
        """(N,) m, springback of the contour formed last under the force measured on it; None: not known."""
        if self._contour is None or not self.force.measured(self._contour):
            return None
        try:
            return self.predict(self._contour).springback
        except IsfError:
            return None
