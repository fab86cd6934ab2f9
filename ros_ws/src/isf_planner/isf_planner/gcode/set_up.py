"""What an operator sets up at the machine and a program only names: work offsets and tools (Torrao 2013, 6.1.4)."""

from __future__ import annotations

from pathlib import Path

from isf_core.files import yaml_file
from isf_core.files.quantity import Length
from isf_core.files.yaml_file import FileModel
from pydantic import Field, field_validator

WORK_SYSTEMS = (54, 55, 56, 57)
"""Work coordinate systems, G54 to G57."""


class MountedTool(FileModel):
    """A tool of the library."""

    length: Length = Field(ge=0.0, lt=1.0)
    """From the spindle's nose to the tip."""
    radius: Length | None = Field(default=None, gt=0.5e-3, lt=50e-3)
    """Of the tip; None: the job's."""


class SetUp(FileModel):
    """Work offsets and tools of one cell."""

    work_offsets: dict[str, tuple[Length, Length, Length]] = Field(default_factory=dict)
    """G54 to G57: origin of the work coordinates in frame ``sheet``; zero where left out."""
    tools: dict[int, MountedTool] = Field(default_factory=dict)
    """Number, as T and H name it, to tool."""
    mounted: int | None = None
    """Tool in the spindle when the program begins."""

    @field_validator("work_offsets")
    @classmethod
    def _known_systems(cls, offsets: dict[str, tuple[float, float, float]]) -> dict[str, tuple[float, float, float]]:
        unknown = set(offsets) - {f"G{number}" for number in WORK_SYSTEMS}
        if unknown:
            raise ValueError(f"{', '.join(sorted(unknown))} is no work coordinate system: G54 to G57")
        return offsets

    def offset(self, system: int) -> tuple[float, float, float]:
        """Origin, m, of the work coordinates ``system`` (54 to 57) in frame ``sheet``."""
        return self.work_offsets.get(f"G{system}", (0.0, 0.0, 0.0))


def load_set_up(path: Path) -> SetUp:
    """Set-up of a YAML file; raises IsfError as :func:`isf_core.files.yaml_file.load`."""
    return yaml_file.load(path, SetUp)
