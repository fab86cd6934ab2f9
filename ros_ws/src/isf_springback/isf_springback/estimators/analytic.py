"""Method "analytic": springback from the measured force and the closed-form deflection of the sheet.

For every control point of the coming contour: forecast of the axial sheet load -> line load
q = F / (2 (l + m)) over the perimeter of the contact patch -> cubic a w^3 + b w = q with the local radius of the
opening -> correction along the push direction (Praveen 2020, eq. 1-16 and 19-22; force in place of the predicted
one and block logic: Ren 2018, 4.3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_core.geometry.opening import ClampRadius
from isf_core.process.deflection import SheetSection, ring_deflection
from isf_core.process.forming_force import contact_perimeter
from isf_core.types import Array

from isf_springback.estimators.estimator import Prediction
from isf_springback.estimators.sheet_model import (
    SECTORS,
    AxialForce,
    ExpectedForce,
    FirstContour,
    ForecastLaw,
    SheetModel,
)
from isf_springback.loop_path import LoopSamples, forming_radii
from isf_springback.sheet_edge import free_ring

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
    law, first_contour : force forecast, see :class:`~isf_springback.estimators.sheet_model.AxialForce`
    control_points : places along the contour where force and model are evaluated
    """

    sheet_term: SheetTerm = "realised"
    clamp: ClampRadius = "equivalent"
    law: ForecastLaw = "linear"
    first_contour: FirstContour = "predicted"
    control_points: int = SECTORS


class AnalyticModel(SheetModel):
    """See the module text."""

    name = "analytic"

    def __init__(self, job_file: JobFile, options: AnalyticOptions | None = None) -> None:
        self._options = options or AnalyticOptions(first_contour=job_file.job.springback.first_contour)
        super().__init__(job_file, AxialForce(job_file, self._options.law, self._options.first_contour))
        self._radius = forming_radii(job_file)
        material = job_file.material
        self._section = SheetSection(material.young_modulus, material.poisson_ratio, job_file.job.sheet.thickness)

    def predict(self, contour: Contour) -> Prediction:
        """As the base class; raises NO_FORCE_HISTORY."""
        samples = LoopSamples.of(contour, self._options.control_points)
        expected = self.force.at(contour, samples.tip, samples.wall_angle)
        springback = self._springback(contour, samples.contact[:, :2], samples.wall_angle, expected)
        lifted = self.lifted.at(samples.contact, springback)
        along, deviation = samples.along(lifted.springback, lifted.deviation)
        return Prediction(
            along,
            deviation=deviation,
            control_point=samples.contact,
            control_point_springback=lifted.springback,
            control_point_force=expected.force,
            remarks=self.lift_remarks,
        )

    def springback_under(self, contour: Contour, point: int, force: Array) -> Array:
        """As the base class."""
        count = len(force)
        place, tip = (np.tile(known[point, :2], (count, 1)) for known in (contour.contact, contour.forming_tip))
        angle = np.full(count, contour.wall_angle[point])
        return self._springback(contour, place, angle, ExpectedForce(force, self.force.steepest(angle, tip)))

    def _springback(self, contour: Contour, place: Array, angle: Array, expected: ExpectedForce) -> Array:
        """(M,) m, springback against the push direction at ``place`` (M, 2) m, wall angle ``angle`` (M,) rad.

        The contact patch is that of the steepest wall met so far: on the fillet of a floor the local angle gives a
        short patch and a high line load, though the sheet between opening and clamp feels the same force.
        """
        assert self.force.opening is not None  # set by begin
        outer, radius = free_ring(self.job_file, self.force.opening, place, self._options.clamp)
        tool, step = self._radius[contour.forming_tool], self.job_file.job.path.incremental_depth
        load = expected.force / contact_perimeter(expected.steepest, tool, step)
        return ring_deflection(self._section, outer, radius, load) * self._axial_share(angle)

    def _axial_share(self, angle: Array) -> Array:
        if self._options.sheet_term == "component":
            return np.asarray(np.cos(angle))
        if self._options.sheet_term == "axial":
            return np.ones(len(angle))
        return np.full(len(angle), REALISED[self.job_file.rig.clamp.edge])
