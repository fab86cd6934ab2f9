"""The part section of a job file: which CAD surface, in which unit."""

from __future__ import annotations

from typing import Literal

from isf_core.model_base import FileModel


class PartSpec(FileModel):
    """The CAD surface: the upper face of the formed sheet, opening towards +z."""

    mesh: str
    """Path of the mesh file, relative to the job file."""
    unit: Literal["m", "cm", "mm", "in"]
    """Unit of the mesh coordinates; never guessed."""
