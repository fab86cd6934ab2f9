"""Job files: everything that is chosen for one part (mesh, process, tools, path, control, springback)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

from pydantic import Field, PrivateAttr, model_validator

from isf_core import yaml_file
from isf_core.contour import Process
from isf_core.job_adsif import AdsifSpec
from isf_core.job_control import ControlSpec
from isf_core.job_part import PartSpec
from isf_core.job_path import PathSpec
from isf_core.job_springback import SpringbackSpec
from isf_core.job_tooling import BackingPlateSpec, DieSpec, SheetSpec, ToolSpec
from isf_core.material import Material, load_material
from isf_core.model_base import FileModel
from isf_core.quantity import Angle
from isf_core.rig import Rig, load_rig
from isf_core.support_window import SupportWindow, check_window, support_window


class Job(FileModel):
    """One part to be formed."""

    name: str = Field(min_length=1, max_length=80, pattern=r"^[A-Za-z0-9_.-]+$")
    part: PartSpec
    process: Literal["SPIF", "TPIF", "DSIF", "ADSIF"]
    rig: str
    sheet: SheetSpec
    tool_1: ToolSpec
    tool_2: ToolSpec | None = None
    backing_plate: BackingPlateSpec | None = None
    die: DieSpec | None = None
    path: PathSpec
    adsif: AdsifSpec | None = None
    control: ControlSpec = ControlSpec()
    springback: SpringbackSpec = SpringbackSpec()
    wall_angle_limit: Angle | None = Field(default=None, gt=0.0, lt=1.5708)
    """Overrides the material's largest wall angle."""
    _support_window: SupportWindow | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _tools(self) -> Job:
        if self.process in ("DSIF", "ADSIF") and self.tool_2 is None:
            raise ValueError(f"process {self.process} needs tool_2")
        if self.adsif is not None and self.process != "ADSIF":
            raise ValueError(f"process {self.process} has no section adsif: use ADSIF, or leave adsif out")
        if self.process == "TPIF" and self.die is None:
            raise ValueError("process TPIF needs die (mesh and unit)")
        if self.die is not None and self.process != "TPIF":
            raise ValueError(f"process {self.process} has no die: use TPIF, or leave die out")
        if self.process in ("SPIF", "TPIF") and self.control.force_controlled:
            raise ValueError(f"process {self.process} has no support tool: control.support_force must be 0 N")
        return self

    @model_validator(mode="after")
    def _path_of_process(self) -> Job:
        if problem := self.path.without_effect(self.process):
            raise ValueError(problem)
        if self.path.support == "on_blank" and self.control.force_controlled:
            raise ValueError("path.support on_blank has no force control: control.support_force must be 0 N")
        return self

    @model_validator(mode="after")
    def _compensated_once(self) -> Job:
        wanted = self.path.compensation
        if "sheet" in wanted and self.springback.method != "none":
            raise ValueError(
                "path.compensation sheet and springback.method correct the same deflection: use one of them"
            )
        if "tool" in wanted and self.tool_1.stick_out is None:
            raise ValueError("path.compensation tool needs tool_1.stick_out")
        if "tool" in wanted and self.control.compliance_compensation > 0:
            raise ValueError(
                "path.compensation tool and control.compliance_compensation correct the same deflection: set the "
                "latter to 0, or leave tool out"
            )
        if "machine" in wanted and self.tool_2 is None:
            raise ValueError("path.compensation machine needs two tools: it corrects the distance between them")
        return self

    @property
    def support_window(self) -> SupportWindow | None:
        """Limits that ``control.support_force: auto`` is chosen between; None with a given force."""
        return self._support_window

    def support_force_at(self, wall_angle: float = math.radians(45.0)) -> float:
        """N, set-point of the support tool on a wall of ``wall_angle`` rad; 0 = position control."""
        given = self.control.support_force
        if given != "auto":
            return given
        return 0.0 if self._support_window is None else self._support_window.set_point(wall_angle)

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
        self.job._support_window = _support_window(self)
        self.mesh: Path = (base / self.job.part.mesh).resolve()


def _support_window(job_file: JobFile) -> SupportWindow | None:
    """Raises IsfError SUPPORT_FORCE_WINDOW when the support force is to be chosen, but none serves."""
    job, material, rig = job_file.job, job_file.material, job_file.rig
    if job.control.support_force != "auto" or job.tool_2 is None:
        return None
    radius = min(job.tool_1.ball_radius, job.tool_2.ball_radius)
    window = support_window(
        material.tensile_strength, radius, job.sheet.thickness, rig.contact_stiffness, rig.limits.offset
    )
    check_window(window, job.wall_angle_limit or material.max_wall_angle, material.name)
    return window


def load_job(path: str | Path) -> JobFile:
    """Job file with its material and rig; raises IsfError naming file, line and field."""
    path = Path(path)
    return JobFile(yaml_file.read(path), path.resolve().parent, str(path))
