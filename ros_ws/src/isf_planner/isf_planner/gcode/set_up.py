"""What an operator sets up at the machine and a program only names: work offsets and tools (Torrao 2013, 6.1.4)."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import yaml
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.quantity import Length
from isf_core.files.tooling import TOOLS, ToolSpec, load_named
from isf_core.files.whole_file import replacing
from isf_core.files.yaml_file import FileModel
from pydantic import Field, field_validator, model_validator

WORK_SYSTEMS = (54, 55, 56, 57)
"""Work coordinate systems, G54 to G57."""


class MountedTool(FileModel):
    """A tool of the library."""

    length: Length = Field(ge=0.0, lt=1.0)
    """From the spindle's nose to the tip."""
    radius: Length | None = Field(default=None, gt=0.5e-3, lt=50e-3)
    """Of the tip; None: the job's."""
    corner_radius: Length | None = Field(default=None, gt=0.1e-3, lt=50e-3)
    """Of a flat tip; None: hemisphere."""

    @model_validator(mode="after")
    def _corner(self) -> MountedTool:
        if self.corner_radius is not None and (self.radius is None or self.corner_radius > self.radius):
            raise ValueError("corner_radius, the rounding of a flat tip, needs a radius that is not smaller")
        return self

    @property
    def tip(self) -> ToolSpec | None:
        """Its tip as a tool of a job; None: the job's."""
        return None if self.radius is None else ToolSpec(radius=self.radius, corner_radius=self.corner_radius)


class SetUp(FileModel):
    """Work offsets and tools of one cell."""

    work_offsets: dict[str, tuple[Length, Length, Length]] = Field(default_factory=dict)
    """G54 to G57: origin of the work coordinates in frame ``sheet``; zero where left out."""
    tools: dict[int, MountedTool] = Field(default_factory=dict)
    """Number, as T and H name it, to tool: its fields, or its name in the library, or a path relative to this file."""
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
    """Set-up of a YAML file, with the tools of the library that it names.

    Raises
    ------
    IsfError : as :func:`isf_core.files.yaml_file.load` and :func:`isf_core.files.tooling.load_named`; FILE_FIELD for a
        tool without stick_out, which is its length
    """
    text = yaml_file.read(path)
    return yaml_file.parse(_with_named_tools(text, path), SetUp, str(path), [(str(path), text)])


def _with_named_tools(text: str, path: Path) -> str:
    data = yaml_file.content(text, str(path))
    tools = data.get("tools") if isinstance(data, dict) else None
    if not isinstance(tools, dict):
        return text
    named = {}
    for number, value in tools.items():
        if isinstance(value, str):
            where = f"{path}:{yaml_file.line_of(text, ('tools', number))}"
            tool = load_named(TOOLS, value, path.parent, where)
            assert isinstance(tool, ToolSpec)
            if tool.stick_out is None:
                what = f"{value} has no stick_out, which is the length that G43 counts"
                raise IsfError(ErrorCode.FILE_FIELD, what, where=where, advice="add it to the file of the tool")
            lengths = {"length": tool.stick_out, "radius": tool.radius, "corner_radius": tool.corner_radius}
            named[number] = {key: f"{1e3 * value:.9g} mm" for key, value in lengths.items() if value is not None}
    return yaml.safe_dump({**data, "tools": tools | named}, allow_unicode=True) if named else text


def cell_set_up_path(rig: str) -> Path:
    """File of the cell of ``rig`` (its name), which need not exist: in $ISF_CELLS, else in the user's configuration."""
    chosen = os.environ.get("ISF_CELLS")
    configuration = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    folder = Path(chosen) if chosen else configuration / "isf" / "cells"
    return folder / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', rig)}.yaml"


def cell_set_up(rig: str) -> tuple[SetUp, Path | None]:
    """Set-up that was stored for the cell of ``rig``, and its file; an empty one, and None, where none was.

    Raises IsfError as :func:`load_set_up`.
    """
    path = cell_set_up_path(rig)
    return (load_set_up(path), path) if path.is_file() else (SetUp(), None)


def store_work_offset(path: Path, system: int, origin: tuple[float, float, float]) -> None:
    """Write the ``origin`` (3,) m of work coordinates ``system`` (54 to 57) into the set-up file ``path``, in one step.

    Everything else that stands in the file stays, but its comments. Raises IsfError as :func:`load_set_up`, and
    FILE_NOT_WRITABLE.
    """
    content: dict[str, Any] = {}
    if path.is_file():
        load_set_up(path)  # what is not understood is not written over
        content = yaml_file.content(yaml_file.read(path), str(path)) or {}
    offsets = content.setdefault("work_offsets", {})
    offsets[f"G{system}"] = [f"{1e3 * value:.4f} mm" for value in origin]
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    advice = "check the folder and its permissions, or set ISF_CELLS to another one"
    with replacing(path, make_folder=True, advice=advice) as file:
        file.write(f"# work offsets and tools of a cell; isf zero writes the offsets\n{text}".encode())
