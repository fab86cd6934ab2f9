"""What is set up at the machine for a part: blank, tools and backing plate, as sections of a job and as library files.

A job writes the section, or the name of a file in its place (``tool_1: spif_a_ball_10``, ``backing_plate: mine.yaml``),
as it names rig and material. Such a file holds the fields of the section, its name and where its constants come from.
Text of a job that is sent to a node or kept in a recording has the fields in place of the names, so that neither the
library nor a file of one's own is needed to read it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import Field, model_validator

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.quantity import Length, Stress
from isf_core.files.yaml_file import FileModel, find_named
from isf_core.geometry.loops import area_of, crosses_itself, inside_loops
from isf_core.types import Array

SMALLEST_OPENING = 1e-6
"""m^2, of a backing plate: a loop around less is a slip of the pen."""


class SheetSpec(FileModel):
    """The blank."""

    material: str
    """Material file by name, or a path relative to the job file."""
    thickness: Length = Field(gt=0.05e-3, lt=10e-3)
    """Of the blank."""
    size: tuple[Length, Length] | None = None
    """Of the blank in x and y; smaller than the free sheet in the rig's clamp is refused. None: it is large enough."""
    name: str | None = None
    """Of the blank; that of its file where the job names one."""

    @model_validator(mode="after")
    def _extent(self) -> SheetSpec:
        if self.size is not None and min(self.size) <= 0:
            raise ValueError("size must be positive")
        return self


class HolderPart(FileModel):
    """A cylinder or cone about the tool's axis."""

    length: Length = Field(gt=1e-3, lt=1.0)
    """Along the axis."""
    radius: Length = Field(gt=0.5e-3, lt=0.5)
    """At its lower end."""
    top_radius: Length | None = Field(default=None, gt=0.5e-3, lt=0.5)
    """At its upper end; None: ``radius``, a cylinder."""


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
    holder: tuple[HolderPart, ...] = ()
    """What holds the shank, from the chuck (``stick_out``) upwards: a forming tool must not run into anything with it,
    an upright one as far as this or ``stick_out`` tells of it; none: a cylinder 60 mm long of radius 25 mm (assumed),
    70 mm above the tip without ``stick_out`` (assumed)."""
    young_modulus: Stress = Field(default=210e9, gt=1e9, lt=1e12)
    """Of the tool; the default is that of steel."""
    name: str | None = None
    """Of the tool; that of its file where the job names one."""

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

    shape: Literal["circle", "rectangle", "outline"]
    """Of the opening; an outline is cut along ``openings``."""
    size: tuple[Length, Length] | None = None
    """Opening in x and y: diameters of a circle (equal), sides of a rectangle; not of an outline."""
    corner_radius: Length = Field(default=0.0, ge=0)
    """Of a rectangle in plan view."""
    openings: tuple[tuple[tuple[Length, Length], ...], ...] = ()
    """Of an outline: the corners, x and y, of one closed loop for each opening; none within another one."""
    edge_radius: Length = Field(default=2e-3, ge=0)
    """Rounding of the plate's upper edge."""
    name: str | None = None
    """Of the plate; that of its file where the job names one."""

    @model_validator(mode="after")
    def _opening(self) -> BackingPlateSpec:
        if self.shape == "outline":
            return self._outline()
        if self.openings:
            raise ValueError("openings belong to shape: outline")
        if self.size is None:
            raise ValueError("size is missing")
        if min(self.size) <= 0:
            raise ValueError("size must be positive")
        if self.shape == "circle" and self.size[0] != self.size[1]:
            raise ValueError("the two sizes of a circle must be equal")
        if self.corner_radius > min(self.size) / 2:
            raise ValueError("corner_radius must not exceed half the smaller side")
        return self

    def _outline(self) -> BackingPlateSpec:
        if self.size is not None or self.corner_radius:
            raise ValueError("an outline has openings, and neither size nor corner_radius")
        if not self.openings:
            raise ValueError("openings are missing: the corners of at least one loop")
        for number, loop in enumerate(self.loops, start=1):
            if len(loop) < 3 or abs(area_of(loop)) < SMALLEST_OPENING:
                raise ValueError(f"opening {number} encloses nothing")
            if crosses_itself(loop):
                raise ValueError(f"opening {number} crosses itself")
        return self

    @cached_property
    def loops(self) -> tuple[Array, ...]:
        """(N, 2) m, corners of every opening of an outline, counter-clockwise."""
        loops = [np.array(opening, dtype=np.float64).reshape(-1, 2) for opening in self.openings]
        return tuple(loop if area_of(loop) > 0.0 else loop[::-1] for loop in loops)

    @property
    def edges(self) -> tuple[Array, ...]:
        """(N, 2) m, corners of the edge of every opening, counter-clockwise; of one that is round, 1 deg apart."""
        if self.size is None:
            return self.loops
        round_to = 0.5 * self.size[0] if self.shape == "circle" else self.corner_radius
        angle = np.radians(np.arange(0.5, 360.0)) if round_to > 0.0 else np.radians(np.arange(45.0, 360.0, 90.0))
        directions = np.column_stack([np.cos(angle), np.sin(angle)])
        return (np.sign(directions) * (0.5 * np.array(self.size) - round_to) + round_to * directions,)

    @property
    def extent(self) -> tuple[float, float]:
        """m, smallest rectangle around 0, along x and y, that holds the opening."""
        if self.size is not None:
            return self.size
        x, y = 2.0 * np.abs(np.vstack(self.loops)).max(axis=0)
        return float(x), float(y)

    @property
    def round_radius(self) -> float:
        """m, of the circle as large as the opening; of several, as the largest one."""
        if self.size is None:
            return math.sqrt(max(map(area_of, self.loops)) / math.pi)
        x, y = self.size
        return 0.5 * x if self.shape == "circle" else math.sqrt(x * y / math.pi)

    def inside(self, x: Array, y: Array) -> Array:
        """m, distance of the places ``x``, ``y`` m (any equal shapes) from the edge of the opening; negative beyond."""
        if self.size is None:
            return inside_loops(self.loops, x, y)
        if self.shape == "circle":
            return np.asarray(0.5 * self.size[0] - np.hypot(x, y))
        ox = np.abs(x) - (0.5 * self.size[0] - self.corner_radius)
        oy = np.abs(y) - (0.5 * self.size[1] - self.corner_radius)
        outside = np.hypot(np.maximum(ox, 0.0), np.maximum(oy, 0.0))
        return np.asarray(self.corner_radius - outside - np.minimum(np.maximum(ox, oy), 0.0))

    def height(self, x: Array, y: Array) -> Array:
        """m, upper face of the plate with its rounded edge over the places: 0 on the flat, -inf in the opening."""
        back, radius = -self.inside(x, y), self.edge_radius
        rounded = np.sqrt(np.maximum(radius**2 - np.clip(radius - back, 0.0, radius) ** 2, 0.0)) - radius
        return np.where(back >= 0.0, np.where(back < radius, rounded, 0.0), -np.inf)


class ToolFile(ToolSpec):
    """A tool of the library."""

    name: str
    """Of the tool, as its file is called."""
    provenance: dict[str, str]
    """Constant to its origin: published, calibrated or assumed, with the source."""


class BlankFile(SheetSpec):
    """A blank of the library."""

    name: str
    """Of the blank, as its file is called."""
    size: tuple[Length, Length]
    """In x and y, with what the clamp holds."""
    provenance: dict[str, str]
    """Constant to its origin: published, calibrated or assumed, with the source."""


class PlateFile(BackingPlateSpec):
    """A backing plate of the library."""

    name: str
    """Of the plate, as its file is called."""
    provenance: dict[str, str]
    """Constant to its origin: published, calibrated or assumed, with the source."""


@dataclass(frozen=True)
class Library:
    """Files of one kind.

    Attributes
    ----------
    folder : in ``share/isf_core``, also what people call the kind
    model : of a file
    sections : of a job that may name one
    """

    folder: str
    model: type[ToolFile] | type[BlankFile] | type[PlateFile]
    sections: tuple[str, ...]


TOOLS = Library("tools", ToolFile, ("tool_1", "tool_2"))
BLANKS = Library("blanks", BlankFile, ("sheet",))
PLATES = Library("plates", PlateFile, ("backing_plate",))
LIBRARIES = (TOOLS, BLANKS, PLATES)


def load_named(
    library: Library, name_or_path: str, base: Path | None = None, where: str = ""
) -> ToolFile | BlankFile | PlateFile:
    """File of ``library`` by name, or by path relative to ``base``; ``where``: what names it, for errors.

    Raises
    ------
    IsfError : FILE_NOT_FOUND; FILE_SYNTAX, FILE_UNIT, FILE_FIELD with file and line, also for a constant whose origin
        is not stated
    """
    return _read(library, _find(library, name_or_path, base, where))[0]


def _find(library: Library, name_or_path: str, base: Path | None, where: str) -> Path:
    try:
        return find_named(library.folder, name_or_path, base)
    except IsfError as error:
        advice = f"{error.advice}; one of your own: the path of its file, NAME.yaml"
        raise IsfError(error.code, error.what, where=where or error.where, advice=advice) from error


def _read(library: Library, path: Path) -> tuple[ToolFile | BlankFile | PlateFile, dict[str, Any]]:
    """The checked file and what is written in it."""
    text = yaml_file.read(path)
    found = yaml_file.parse(text, library.model, str(path))
    written: dict[str, Any] = yaml_file.content(text, str(path))
    for constant in sorted(set(written) - {"name", "provenance"} - set(found.provenance)):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"provenance is missing for {constant}",
            where=f"{path}:{yaml_file.line_of(text, (constant,))}",
            advice="write published, calibrated or assumed and the source",
        )
    return found, written


def with_named_sections(text: str, base: Path, name: str) -> str:
    """The job ``text`` with the fields of library files where it names them; the same text where it names none.

    ``base``: folder that paths are relative to; ``name``: of the job in errors. A text that is no job is left as it is,
    for the job's own checks.

    Raises
    ------
    IsfError : as :func:`isf_core.files.yaml_file.content` and :func:`load_named`; FILE_NOT_FOUND names the line of the
        job
    """
    job = yaml_file.content(text, name)
    if not isinstance(job, dict):
        return text
    named = {
        section: _section(library, job[section], base, f"{name}:{yaml_file.line_of(text, (section,))}")
        for library in LIBRARIES
        for section in library.sections
        if isinstance(job.get(section), str)
    }
    return yaml.safe_dump(job | named, sort_keys=False, allow_unicode=True, width=10_000) if named else text


def _section(library: Library, value: str, base: Path, where: str) -> Mapping[str, Any]:
    """Fields of the file ``value`` for a job whose line ``where`` names it."""
    path = _find(library, value, base, where)
    _, written = _read(library, path)
    fields = {key: item for key, item in written.items() if key != "provenance"}
    material = fields.get("material")
    if isinstance(material, str) and yaml_file.is_path(material):
        fields["material"] = str((path.parent / material).resolve())
    return fields
