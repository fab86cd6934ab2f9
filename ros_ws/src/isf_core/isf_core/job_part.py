"""The part section of a job file: which CAD surface, in which unit, which way up and where on the blank."""

from __future__ import annotations

from pathlib import PurePath
from typing import Literal

from pydantic import Field, model_validator

from isf_core.model_base import FileModel
from isf_core.quantity import Angle, Length

MeshUnit = Literal["m", "cm", "mm", "in"]
METRES: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 25.4e-3}
"""Length of the units that a mesh may have."""

UNIT_IN_FILE = (".step", ".stp", ".iges", ".igs", ".3mf")
"""Formats that carry their unit."""


class PartSpec(FileModel):
    """The CAD surface: the upper face of the formed sheet, opening towards +z."""

    mesh: str
    """Path of the mesh file, relative to the job file."""
    unit: MeshUnit | None = None
    """Unit of the mesh coordinates; never guessed. Only formats that carry their unit (STEP, IGES, 3MF) need none."""
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = "+z"
    """Axis of the file that points up, out of the open side of the part."""
    turn: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Turns about x, y and z of the file, one after the other, before ``up`` is set upright."""
    scale: float = Field(default=1.0, gt=1e-3, lt=1e3)
    """Factor on all lengths."""
    place: tuple[Length, Length] | None = None
    """x and y of the outline's centre on the blank; the centre of the blank when left out."""
    repair: bool = True
    """Repair cracks, duplicate and turned facets and holes narrower than the tool; each is told. False: refuse them."""

    @model_validator(mode="after")
    def _unit_declared(self) -> PartSpec:
        if self.unit is None and PurePath(self.mesh).suffix.lower() not in UNIT_IN_FILE:
            raise ValueError(f"unit is missing: '{self.mesh}' carries none; write unit: mm (or m, cm, in)")
        return self
