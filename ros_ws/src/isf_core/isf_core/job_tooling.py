"""The tooling sections of a job file: blank, tools, and what stands under the sheet (backing plate, die)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from isf_core.job_part import MeshUnit
from isf_core.model_base import FileModel
from isf_core.quantity import Length, Stress


class SheetSpec(FileModel):
    """The blank."""

    material: str
    thickness: Length = Field(gt=0.05e-3, lt=10e-3)


class ToolSpec(FileModel):
    """A tool with a hemispherical tip, or a flat tip with a corner radius."""

    radius: Length = Field(gt=0.5e-3, lt=50e-3)
    """Radius of the hemisphere; of a flat tip: of its whole circle."""
    corner_radius: Length | None = Field(default=None, gt=0.1e-3, lt=50e-3)
    """Flat tip: radius of its rounded edge, at most ``radius``; None: hemisphere."""
    stick_out: Length | None = Field(default=None, gt=1e-3, lt=1.0)
    """From the chuck to the tip; needed for compensation of the tool's own bending."""
    shank_radius: Length | None = Field(default=None, gt=0.5e-3, lt=0.2)
    """Of the shank; None: ``radius``."""
    young_modulus: Stress = Field(default=210e9, gt=1e9, lt=1e12)
    """Of the tool; the default is that of steel."""

    @model_validator(mode="after")
    def _corner(self) -> ToolSpec:
        if self.corner_radius is not None and self.corner_radius > self.radius:
            raise ValueError("corner_radius must not exceed radius")
        return self

    @property
    def ball_radius(self) -> float:
        """m, radius of the rounding that touches the wall: of the hemisphere, or of a flat tip's corner."""
        return self.radius if self.corner_radius is None else self.corner_radius

    @property
    def flat_radius(self) -> float:
        """m, radius of the flat of the tip, 0 for a hemisphere."""
        return self.radius - self.ball_radius


class BackingPlateSpec(FileModel):
    """A rigid plate under the sheet with an opening around the path, centred in the clamp."""

    shape: Literal["circle", "rectangle"]
    size: tuple[Length, Length]
    """Opening in x and y: diameters of a circle (equal), sides of a rectangle."""
    corner_radius: Length = Field(default=0.0, ge=0)
    """Of a rectangle in plan view."""
    edge_radius: Length = Field(default=2e-3, ge=0)
    """Rounding of the plate's upper edge."""

    @model_validator(mode="after")
    def _opening(self) -> BackingPlateSpec:
        if min(self.size) <= 0:
            raise ValueError("size must be positive")
        if self.shape == "circle" and self.size[0] != self.size[1]:
            raise ValueError("the two sizes of a circle must be equal")
        if self.corner_radius > min(self.size) / 2:
            raise ValueError("corner_radius must not exceed half the smaller side")
        return self


class DieSpec(FileModel):
    """TPIF: a partial or full die under the sheet, as a surface in frame ``sheet`` with the blank holder at its start.

    The clamped sheet moves down over the die with the blank holder; in frame ``sheet`` the die rises.
    """

    mesh: str
    """Path of the mesh of the die's upper surface, relative to the job file."""
    unit: MeshUnit
