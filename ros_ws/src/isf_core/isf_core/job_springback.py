"""The springback section of a job file: how each contour is corrected before it is formed."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, model_validator

from isf_core.model_base import FileModel
from isf_core.quantity import Angle, Force, Length, Stress


class MpcSpec(FileModel):
    """Model-predictive control from scans; the defaults are those of Lu 2016 (Tables 3-5) unless said otherwise."""

    horizon: int = Field(default=6, ge=0, le=100)
    """Contours looked ahead; 0: to the end of the part."""
    vertical_weight: float = Field(default=0.2, ge=0.0, le=100.0)
    """lambda_z, damps the step depth."""
    horizontal_weight: float = Field(default=0.7, ge=0.0, le=100.0)
    """lambda_h, holds the horizontal increment near the planned one."""
    smallest_step: float = Field(default=0.5, gt=0.0, le=1.0)
    """Smallest step depth, in planned steps."""
    largest_step: float = Field(default=2.0, gt=1.0, le=10.0)
    """Largest step depth, in planned steps; above 1, or a lag could never be made good."""
    horizontal_change: Length = Field(default=0.5e-3, gt=0.0, lt=5e-3)
    """Largest departure e of a horizontal increment from the planned one."""
    largest_offset: Length = Field(default=10e-3, gt=0.0, lt=30e-3)
    """Largest departure from the planned path in all (assumed)."""
    reference_angles: tuple[Angle, ...] = (math.radians(45.0),)
    """Directions whose section is optimised, seen from the middle of the contour; one is published for the pyramid,
    five (0, 45, 90, 180, 270 deg) for the asymmetric cone."""
    distribution: Literal["none", "uniform", "interpolated", "dense"] = "interpolated"
    """Horizontal springback between the reference directions; dense: every direction is measured and optimised."""
    step: Literal["common", "per_direction"] = "common"
    """One step depth for the whole contour (published), or one for every direction."""
    coupled: bool = False
    """Optimise step depth and horizontal increment in one problem, with slope and offset as constraints."""
    solver: Literal["scipy", "piqp"] = "scipy"

    @model_validator(mode="after")
    def _directions(self) -> MpcSpec:
        if not self.reference_angles:
            raise ValueError("reference_angles needs one direction or more")
        return self


class ElasticSpec(FileModel):
    """Method "elastic": shell model of the partly formed sheet at few control points (Ren 2018, 4.2 and 4.3)."""

    database: str | None = None
    """File made by ``isf springback database``, relative to the job file; without it the user's cache is looked into,
    and what is not there is computed while forming."""
    edge_slope: Literal["clamped", "supported"] = "clamped"
    edge_stiffness: Stress | None = Field(default=None, ge=0.0)
    """In-plane spring of the clamped edge, force per displacement and length; ``isf springback calibrate`` finds it
    from a push on the flat sheet. Without it the edge is free or immovable as the rig says."""
    loop_increment: Length = Field(default=1e-3, gt=0.0)
    """Depth between control loops (published)."""
    largest_load: Force = Field(default=1000.0, gt=10.0)
    """Largest load of the samples; published 600 N, which the forces of deep cones exceed."""
    engine: Literal["compact", "kratos"] = "compact"
    """What computes the samples of a database and ``predict``: the shell of this package, or KratosMultiphysics, which
    is installed by itself, takes some twenty times as long and gives the same. While forming it is the former."""
    forecast: Literal["hold", "half_step", "linear"] = "hold"
    """Force forecast; half_step is the published 1.5 F_(i-1) - 0.5 F_(i-2). The more a forecast runs ahead, the more
    the force that a deeper push raises swings the next push: see docs/springback.md."""
    block: int = Field(default=1, ge=1)
    """Contours per force forecast (published: 5)."""
    horizontal: bool = False
    """Correct across the wall as well, from the measured horizontal force (left uncorrected in the source); the laws
    are computed while forming, about a second per ``loop_increment``."""


class FusedSpec(FileModel):
    """Method "fused": prediction of a model and bias from the scanned shape as one estimate."""

    model: Literal["analytic", "elastic"] = "analytic"
    """What predicts from the force; elastic takes its options from the section ``elastic``."""


class SpringbackSpec(FileModel):
    """Correction of each contour before it is formed."""

    method: str = "none"
    """Name of a method of isf_springback ("none", "analytic", ...)."""
    gain: float = Field(default=1.0, ge=0.0, le=2.0)
    first_contour: Literal["predicted", "zero"] = "predicted"
    """Contours before which no force was measured: corrected for the force that the plan predicts (methods with a
    model of the sheet), or not corrected, as published (Ren 2018, 4.3.1)."""
    scan_every: int = Field(default=0, ge=0)
    """The shape is measured after every so many contours, for methods that use it; 0: never."""
    scan_clear: bool = True
    """Both tools are lifted clear and moved aside before a scan, and approach the sheet again after it; otherwise the
    scan is made with the tools where the contour ended, and what they hide is a hole in it. Open contours (spirals)
    are always scanned so: a tool lifted off in the middle of one leaves a mark."""
    lift_every: int = Field(default=0, ge=0)
    """The forming tool is lifted after every so many contours and measures springback where it stands, for methods
    that use it; 0: never."""
    scan_sensor: bool = False
    """Simulated machine: scans as a scanner sees the part (noise, holes, registration) instead of exact ones."""
    open_loop_contours: int = Field(default=3, ge=0)
    """Contours at the start whose shape is too shallow to be used (published: 3, Lu 2016, 4.2.1)."""
    mpc: MpcSpec = MpcSpec()
    elastic: ElasticSpec = ElasticSpec()
    fused: FusedSpec = FusedSpec()
    learning: str | None = None
    """Correction file made by ``isf learn`` from parts formed before, relative to the job file."""
