"""Sheet materials: constants with the source of each; files in ``share/isf_core/materials``."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from isf_core import yaml_file
from isf_core.errors import ErrorCode, IsfError
from isf_core.model_base import FileModel
from isf_core.quantity import Angle, Stress
from isf_core.shared_files import find_named


class Material(FileModel):
    """An isotropic sheet material.

    ``provenance`` tells of every constant whether it is published, calibrated or assumed.
    """

    name: str
    young_modulus: Stress = Field(gt=1e9, lt=1e12)
    poisson_ratio: float = Field(gt=0, lt=0.5)
    yield_strength: Stress = Field(gt=1e6, lt=5e9)
    tensile_strength: Stress = Field(gt=1e6, lt=5e9)
    friction: float = Field(ge=0, lt=1)
    max_wall_angle: Angle = Field(gt=0.1, lt=1.5708)
    strength_coefficient: Stress | None = Field(default=None, gt=1e6, lt=5e9)
    """K of the flow curve K strain^n; without it the curve is estimated (:mod:`isf_core.flow_curve`)."""
    hardening_exponent: float | None = Field(default=None, ge=0, lt=1)
    """n of the flow curve."""
    provenance: dict[str, str]


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
