"""Sheet materials: constants with the source of each, and the flow curve that follows from them.

Files are in ``share/isf_core/materials``. The flow curve is Hollomon's law: flow stress = K strain^n. Where the
material file does not give K and n, they follow from yield and tensile strength: the tensile test becomes unstable at
the strain n (Considere), so the tensile strength is K (n / e)^n, and the yield strength is taken at the plastic strain
of 0.2 %. This is an estimate; the material file should give measured values where there are some.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.quantity import Angle, Stress
from isf_core.files.yaml_file import FileModel, find_named
from isf_core.types import Array


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
    """Largest wall angle that one pass forms."""
    strength_coefficient: Stress | None = Field(default=None, gt=1e6, lt=5e9)
    """K of the flow curve K strain^n; without it the curve is estimated (:mod:`isf_core.files.material`)."""
    hardening_exponent: float | None = Field(default=None, ge=0, lt=1)
    """n of the flow curve."""
    provenance: dict[str, str]
    """Constant to its origin: published, calibrated or assumed, with the source."""


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


YIELD_STRAIN = 0.002
"""Plastic strain at which yield strength is defined."""

SMALLEST_EXPONENT = YIELD_STRAIN * np.e
"""Hardening exponent at which the estimate gives a tensile strength equal to the yield strength."""


@dataclass(frozen=True)
class FlowCurve:
    """Hollomon's law.

    Attributes
    ----------
    strength_coefficient : Pa, K ; exponent : n
    estimated : from yield and tensile strength, not from the material file
    """

    strength_coefficient: float
    exponent: float
    estimated: bool

    def stress(self, strain: Array | float) -> Array:
        """Pa, flow stress at the equivalent plastic ``strain`` (taken as 0.2 % at least)."""
        return np.asarray(self.strength_coefficient * np.maximum(strain, YIELD_STRAIN) ** self.exponent)


def flow_curve(material: Material) -> FlowCurve:
    """Flow curve of ``material``: its own constants, or estimated from yield and tensile strength."""
    if material.strength_coefficient is not None and material.hardening_exponent is not None:
        return FlowCurve(material.strength_coefficient, material.hardening_exponent, estimated=False)
    ratio = np.log(max(material.tensile_strength / material.yield_strength, 1.0))
    exponent = SMALLEST_EXPONENT
    if ratio > 0.0:
        from scipy.optimize import brentq  # late: 0.3 s that nodes need not pay at their start

        exponent = float(brentq(lambda n: n * np.log(n / SMALLEST_EXPONENT) - ratio, SMALLEST_EXPONENT, 1.5))
    coefficient = material.tensile_strength * (np.e / exponent) ** exponent
    return FlowCurve(float(coefficient), exponent, estimated=True)


def plane_strain(initial: float, thickness: Array | float) -> Array:
    """Equivalent strain of a wall thinned from ``initial`` to ``thickness`` (m) in plane strain: 2/sqrt(3) ln(t0/t)."""
    return np.asarray(2.0 / np.sqrt(3.0) * np.log(np.maximum(initial / np.asarray(thickness), 1.0)))
