"""Sheet materials: constants with the source of each, and the flow curve that follows from them.

Files are in ``share/isf_core/materials``. The flow curve is one of the laws of :mod:`isf_core.files.hardening_law`.
Where the material file gives none, it is Hollomon's, K strain^n, from yield and tensile strength: the tensile test
becomes unstable at the strain n (Considere), so the tensile strength is K (n / e)^n, and the yield strength is taken at
the plastic strain of 0.2 %. This is an estimate; the material file should give measured values where there are some.

The forming limit is the fracture line in principal strains: the sheet tears where major + k minor strain reaches what
it bears in plane strain (Torrao 2013, 2.2.2: parallel to pure shear, k = 1, so the loss of thickness alone decides).
It is what the simulated sheet bears. What a planner allows is ``max_wall_angle``, another thing.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from pydantic import Field, model_validator

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.hardening_law import YIELD_STRAIN, FlowCurve, HardeningLaw, Swift, Tabulated, Voce
from isf_core.files.quantity import Angle, Stress
from isf_core.files.yaml_file import FieldError, FileModel, find_named
from isf_core.types import Array

FlowTable = tuple[tuple[float, Stress], ...]
"""Rows of (plastic strain, flow stress)."""


class Material(FileModel):
    """An isotropic sheet material.

    ``provenance`` tells of every constant whether it is published, calibrated or assumed.
    """

    name: str
    """Name of the material."""
    young_modulus: Stress = Field(gt=1e9, lt=1e12)
    """Of the sheet."""
    poisson_ratio: float = Field(gt=0, lt=0.5)
    """Of the sheet."""
    yield_strength: Stress = Field(gt=1e6, lt=5e9)
    """At 0.2 % plastic strain."""
    tensile_strength: Stress = Field(gt=1e6, lt=5e9)
    """R_m."""
    friction: float = Field(ge=0, lt=1)
    """Coefficient between tool and sheet."""
    max_wall_angle: Angle = Field(gt=0.1, lt=1.5708)
    """Largest wall angle that a plan may have: a rule of the planner, not what a simulated sheet bears."""
    fracture_strain: float | None = Field(default=None, gt=0, lt=4)
    """Major true strain at which the sheet tears in plane strain; without it it is estimated from `max_wall_angle`."""
    fracture_slope: float | None = Field(default=None, ge=0, le=2)
    """k of the fracture line, major strain + k minor strain; 1 without it: the thickness decides."""
    bending_share: float | None = Field(default=None, ge=0, lt=1)
    """Share of the outer fibre's strain that each bend to a tool and back uses up; 0.15 without it."""
    strength_coefficient: Stress | None = Field(default=None, gt=1e6, lt=5e9)
    """K of the flow curve K strain^n; without any law the curve is estimated (:mod:`isf_core.files.material`)."""
    hardening_exponent: float | None = Field(default=None, ge=0, lt=1)
    """n of the flow curve."""
    pre_strain: float | None = Field(default=None, gt=0, lt=1)
    """With K and n, Swift's law K (pre_strain + strain)^n."""
    saturation_stress: Stress | None = Field(default=None, gt=1e6, lt=5e9)
    """Voce's law: what the flow stress grows to from the yield strength on, by 1 - exp(-strain / saturation_strain)."""
    saturation_strain: float | None = Field(default=None, gt=0, lt=10)
    """Plastic strain of Voce's law."""
    flow_curve: FlowTable | None = Field(default=None, min_length=2)
    """Flow curve as points in place of a law: the first at plastic strain 0, linear between, constant after them."""
    kinematic_hardening: float | None = Field(default=None, ge=0, le=0.99)
    """Share of the hardening that moves the yield surface in place of widening it (Prager 1956), so that the sheet
    yields earlier when it is bent back; only the elasto-plastic sheet knows it. Without it 0."""
    provenance: dict[str, str]
    """Constant to its origin: published, calibrated or assumed, with the source."""

    @model_validator(mode="after")
    def _one_flow_curve(self) -> Material:
        laws = [[name for name in law if getattr(self, name) is not None] for law in LAWS]
        given = [law for law in laws if law]
        if len(given) > 1:
            raise FieldError(
                f"the flow curve is given already by {' and '.join(given[0])}",
                field=given[1][0],
                advice="give one law: points, K and n (with pre_strain), or Voce's saturation",
            )
        for needed in (("strength_coefficient", "hardening_exponent"), ("saturation_stress", "saturation_strain")):
            missing = [name for name in needed if getattr(self, name) is None]
            present = next((law[0] for law in given if set(needed) & set(LAWS[laws.index(law)])), None)
            if present and missing:
                raise FieldError(f"needs {' and '.join(missing)} too", field=present, advice="give the whole law")
        if self.saturation_stress is not None and self.saturation_stress <= self.yield_strength:
            raise FieldError(
                "is not above the yield strength", field="saturation_stress", advice="the sheet hardens towards it"
            )
        if self.flow_curve is not None:
            _check_points(self.flow_curve)
        return self


LAWS = (
    ("flow_curve",),
    ("strength_coefficient", "hardening_exponent", "pre_strain"),
    ("saturation_stress", "saturation_strain"),
)
"""Fields of the flow curve, by law."""


def _check_points(rows: FlowTable) -> None:
    (first, begin), *_ = rows
    if first != 0.0 or not begin > 1e6:
        raise FieldError(
            "must begin at plastic strain 0 with the stress at which the sheet yields",
            field="flow_curve",
            advice="write for example [[0, 110 MPa], [0.2, 240 MPa]]",
        )
    for number, ((strain, stress), (next_strain, next_stress)) in enumerate(pairwise(rows), start=2):
        if not next_strain > strain or not next_stress >= stress:
            raise FieldError(
                f"strain must rise and stress must not fall, which point {number} does not keep to",
                field="flow_curve",
                advice="plastic strain and true stress, in the order of strain",
            )


def load_material(name_or_path: str, base: Path | None = None) -> Material:
    """Material by name ("AA5754-O") or by path relative to ``base``; raises IsfError."""
    material = yaml_file.load(find_named("materials", name_or_path, base), Material)
    constants = {name for name in Material.model_fields if getattr(material, name) is not None}
    constants -= {"name", "provenance"}
    missing = constants - set(material.provenance)
    if missing:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"provenance is missing for {', '.join(sorted(missing))}",
            where=name_or_path,
            advice="write published, calibrated or assumed and the source",
        )
    return material


SMALLEST_EXPONENT = YIELD_STRAIN * np.e
"""Hardening exponent at which the estimate gives a tensile strength equal to the yield strength."""


def flow_curve(material: Material) -> HardeningLaw:
    """Flow curve of ``material``: its own law, or Hollomon's estimated from yield and tensile strength."""
    if material.flow_curve is not None:
        return Tabulated(material.flow_curve)
    if material.saturation_stress is not None and material.saturation_strain is not None:
        return Voce(material.yield_strength, material.saturation_stress, material.saturation_strain)
    if material.strength_coefficient is not None and material.hardening_exponent is not None:
        constants = material.strength_coefficient, material.hardening_exponent
        return Swift(*constants, material.pre_strain) if material.pre_strain else FlowCurve(*constants, estimated=False)
    ratio = np.log(max(material.tensile_strength / material.yield_strength, 1.0))
    exponent = SMALLEST_EXPONENT
    if ratio > 0.0:
        from scipy.optimize import brentq  # late: 0.3 s that nodes need not pay at their start

        exponent = float(brentq(lambda n: n * np.log(n / SMALLEST_EXPONENT) - ratio, SMALLEST_EXPONENT, 1.5))
    coefficient = material.tensile_strength * (np.e / exponent) ** exponent
    return FlowCurve(float(coefficient), exponent, estimated=True)


OWN_THINNING = 1.15
"""Thinning of a wall formed in one pass over the sine law's: 1.05 to 1.17 on simulated cones of 45 to 70 deg, R 5 mm.
A largest wall angle becomes a strain by it."""
USUAL_STEP = 0.5
"""Incremental depth over thickness, where the source of a largest wall angle does not print it (assumed)."""
BENDING_SHARE = 0.15
"""Calibrated: AA3103 of 1.5 mm in steps of 1 mm, formed at 76 deg in three passes and torn at 80 deg in four (Behera
2015, Table 1), which 0.13 to 0.22 give."""


@dataclass(frozen=True)
class FormingLimit:
    """When a sheet tears: major + slope minor + bending_share bent reaches the strain; true strains, ``bent`` the sum
    of the outer fibre's strains t / 2R over the bends to tools of radius R.

    Attributes
    ----------
    strain : major strain of a sheet that was not bent, in plane strain ; slope : k ; bending_share
    estimated : the strain is from the largest wall angle, not from the material file
    """

    strain: float
    slope: float
    bending_share: float
    estimated: bool = False


def strain_of_angle(angle: float, bending_share: float = BENDING_SHARE) -> float:
    """What a wall of ``angle`` rad formed in one pass uses up: its thinning, and its bends.

    A tool of radius R that touches R sin a of the wall in plan comes by R sin a tan a / step times, with t / 2R each.
    """
    bends = np.sin(angle) * np.tan(angle) / (2.0 * USUAL_STEP)
    return float(-OWN_THINNING * np.log(np.cos(angle)) + bending_share * bends)


def forming_limit(material: Material) -> FormingLimit:
    """Forming limit of ``material``: its own constants, or the strain estimated from its largest wall angle."""
    own = material.fracture_strain
    share = BENDING_SHARE if material.bending_share is None else material.bending_share
    return FormingLimit(
        strain=strain_of_angle(material.max_wall_angle, share) if own is None else own,
        slope=1.0 if material.fracture_slope is None else material.fracture_slope,
        bending_share=share,
        estimated=own is None,
    )


def plane_strain(initial: float, thickness: Array | float) -> Array:
    """Equivalent strain of a wall thinned from ``initial`` to ``thickness`` (m) in plane strain: 2/sqrt(3) ln(t0/t)."""
    return np.asarray(2.0 / np.sqrt(3.0) * np.log(np.maximum(initial / np.asarray(thickness), 1.0)))
