"""Job files: everything that is chosen for one part (mesh, process, tools, path, control, springback)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from isf_core import yaml_file
from isf_core.contour import Process
from isf_core.material import Material, load_material
from isf_core.model_base import FileModel
from isf_core.quantity import Angle, Force, Frequency, Length, Speed
from isf_core.rig import Rig, load_rig


class PartSpec(FileModel):
    """The CAD surface: the upper face of the formed sheet, opening towards +z."""

    mesh: str
    """Path of the mesh file, relative to the job file."""
    unit: Literal["m", "cm", "mm", "in"]
    """Unit of the mesh coordinates; never guessed."""


class SheetSpec(FileModel):
    """The blank."""

    material: str
    thickness: Length = Field(gt=0.05e-3, lt=10e-3)


class ToolSpec(FileModel):
    """A hemispherical tool."""

    radius: Length = Field(gt=0.5e-3, lt=50e-3)


class PathSpec(FileModel):
    """How the surface is turned into contours."""

    incremental_depth: Length = Field(gt=0.01e-3, lt=5e-3)
    point_spacing: Length = Field(gt=0.05e-3, lt=5e-3)
    feed: Speed = Field(gt=0.1e-3, lt=1.0)
    squeeze_factor: float = Field(default=1.0, gt=0.3, le=1.2)
    """Planned tool gap over predicted thickness; 1 = sine-law gap."""


class ControlSpec(FileModel):
    """Force and compliance control."""

    rate: Frequency = Field(default=500.0, ge=100.0, le=2000.0)
    """Rate f_s of wrenches and targets."""
    support_force: Force = Field(default=0.0, ge=0.0, le=1500.0)
    """Set-point of the horizontal normal force on the support tool; 0 = position control."""
    engage_depth: Length = Field(default=0.0, ge=0.0)
    """Force control acts on contours at least this deep: not on the entry fillet (Ren 2018, 2.4.1)."""
    engage_wall_angle: Angle = Field(default=math.radians(15.0), ge=0.0, lt=1.5708)
    """Force control acts on contours at least this steep: on flat sheet the horizontal normal force has no
    authority (Ren 2018, section 2.4); the default is assumed."""
    compliance_compensation: float = Field(default=1.0, ge=0.0, le=1.0)
    """Factor on the compliance compensation of the forming tool."""


class SpringbackSpec(FileModel):
    """Correction of each contour before it is formed."""

    method: str = "none"
    """Name of a method of isf_springback ("none", "analytic", ...)."""
    gain: float = Field(default=1.0, ge=0.0, le=2.0)


class Job(FileModel):
    """One part to be formed."""

    name: str = Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$")
    part: PartSpec
    process: Literal["SPIF", "TPIF", "DSIF", "ADSIF"]
    rig: str
    sheet: SheetSpec
    tool_1: ToolSpec
    tool_2: ToolSpec | None = None
    path: PathSpec
    control: ControlSpec = ControlSpec()
    springback: SpringbackSpec = SpringbackSpec()
    wall_angle_limit: Angle | None = Field(default=None, gt=0.0, lt=1.5708)
    """Overrides the material's largest wall angle."""

    @model_validator(mode="after")
    def _tools(self) -> Job:
        if self.process in ("DSIF", "ADSIF") and self.tool_2 is None:
            raise ValueError(f"process {self.process} needs tool_2")
        if self.process == "SPIF" and self.control.support_force > 0:
            raise ValueError("process SPIF has no support tool: control.support_force must be 0 N")
        return self

    @property
    def process_type(self) -> Process:
        """The process as the enumeration used in contours."""
        return Process[self.process]


class JobFile:
    """A job with the files it names resolved.

    Attributes
    ----------
    job : Job ; material : Material ; rig : Rig
    mesh : absolute path of the mesh
    text : the YAML text as read, base : folder that relative paths refer to
    """

    def __init__(self, text: str, base: Path, name: str = "job") -> None:
        self.text = text
        self.base = base
        self.job: Job = yaml_file.parse(text, Job, name)
        self.material: Material = load_material(self.job.sheet.material, base)
        self.rig: Rig = load_rig(self.job.rig, base)
        self.mesh: Path = (base / self.job.part.mesh).resolve()


def load_job(path: str | Path) -> JobFile:
    """Job file with its material and rig; raises IsfError naming file, line and field."""
    path = Path(path)
    return JobFile(yaml_file.read(path), path.resolve().parent, str(path))
