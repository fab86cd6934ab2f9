"""The path section of a job file: how the surface is turned into contours."""

from __future__ import annotations

import itertools
import math
from typing import Literal

from pydantic import Field, model_validator

from isf_core.model_base import FileModel
from isf_core.quantity import Acceleration, Angle, Length, Speed


class PathSpec(FileModel):
    """How the surface is turned into contours."""

    incremental_depth: Length = Field(gt=0.01e-3, lt=5e-3)
    point_spacing: Length = Field(gt=0.05e-3, lt=5e-3)
    feed: Speed = Field(gt=0.1e-3, lt=1.0)
    squeeze_factor: float = Field(default=1.0, gt=0.3, le=1.2)
    """Planned tool gap over predicted thickness; 1 = sine-law gap."""

    spacing: Literal["depth", "scallop", "arc"] = "depth"
    """Levels at constant incremental depth, constant scallop height, or constant distance down the wall."""
    scallop_height: Length = Field(default=0.01e-3, gt=0.1e-6, lt=1e-3)
    """Spacing scallop: height of the ridges between neighbouring contours."""
    arc_step: Length = Field(default=0.5e-3, gt=0.01e-3, lt=10e-3)
    """Spacing arc: distance of the contacts of neighbouring contours along the wall, at most."""
    smallest_step: Length = Field(default=0.1e-3, gt=1e-6, lt=5e-3)
    """Spacing scallop or arc: smallest step in depth, which also holds on floors and at the rim."""
    largest_step: Length | None = Field(default=None, gt=0.01e-3, lt=10e-3)
    """Spacing scallop or arc: largest step in depth; None: the incremental depth."""

    style: Literal["contours", "spiral"] = "contours"
    """Separate contours, or one continuous spiral per feature."""
    direction: Literal["ccw", "cw", "alternating"] = "ccw"
    """Sense of travel seen from above; alternating: every other contour the other way round."""
    transition: Literal["step", "ramp"] = "step"
    """Style contours: from contour to contour straight down at the seam, or along a ramp within the wall."""
    ramp_length: Length = Field(default=10e-3, gt=0.5e-3, lt=1.0)
    """Length of the ramp along the contour; the seam moves on by as much with every contour."""
    stagger: Length = Field(default=0.0, ge=0.0, lt=1.0)
    """Transition step: by how much the start of every contour lies further along than that of the one before."""
    acceleration: Acceleration | None = Field(default=None, gt=1e-3, lt=100.0)
    """Largest acceleration of the forming tip: it slows down in corners and at both ends; None: feed everywhere."""
    support: Literal["opposite", "on_blank"] = "opposite"
    """DSIF: the support tool is opposite the contact, or stays under the blank along the first contour."""
    islands: Literal["around", "swap"] = "around"
    """DSIF: what rises from the floor of a pocket is formed around from above, or from below with the tools swapped."""
    stages: tuple[Angle, ...] = ()
    """SPIF and DSIF: largest wall angles of the preforms formed before the part itself, ascending; none: one stage."""
    floor_step: Length | None = Field(default=None, gt=0.2e-3, lt=0.1)
    """SPIF and DSIF: distance of the rings in which the tool passes over a flat floor after the wall; None: none."""
    floor_rounds: int = Field(default=3, ge=1, le=10)
    """How often the floor is passed over, inwards and outwards in turn."""
    thickness: Literal["sine_law", "overlap"] = "sine_law"
    """How the formed thickness is predicted that the support tool's gap follows."""

    compensation: tuple[Literal["tool", "sheet", "machine"], ...] = ()
    """What is compensated in the plan, without feedback: bending of the forming tool, elastic deflection of the sheet,
    error map of the machine."""
    sheet_term: Literal["component", "axial"] = "component"
    """Axial shift for a sheet deflection w: w times the cosine of the wall angle, or the whole w."""
    sheet_gain: float = Field(default=1.0, gt=0.0, le=2.0)
    """Factor on the sheet deflection, to be calibrated; assumed 1."""
    machine_error: str | None = None
    """CSV beside the job: x, y, z in mm and how much farther apart than commanded the tips are there, in mm."""
    machine_error_tool: Literal["support", "tool_1", "tool_2"] = "support"
    """Tool that is moved for it. A gauge between the tips does not tell which tool is off: support keeps the distance
    of the tools right and leaves the part where the forming tool is; else the tool that is known to be off."""

    @model_validator(mode="after")
    def _compensation(self) -> PathSpec:
        if "machine" in self.compensation and self.machine_error is None:
            raise ValueError("compensation machine needs machine_error, the file with the measured errors")
        if len(set(self.compensation)) != len(self.compensation):
            raise ValueError("compensation names something twice")
        return self

    @model_validator(mode="after")
    def _stages(self) -> PathSpec:
        angles = (0.0, *self.stages, 0.5 * math.pi)
        if any(later <= earlier for earlier, later in itertools.pairwise(angles)):
            raise ValueError("stages must be ascending wall angles between 0 and 90 deg")
        return self

    @model_validator(mode="after")
    def _path_choices(self) -> PathSpec:
        joined = self.style == "spiral" or self.transition == "ramp"
        if joined and self.direction == "alternating":
            raise ValueError("direction alternating needs style contours and transition step: joined paths run one way")
        if joined and self.stagger > 0:
            raise ValueError("stagger needs style contours and transition step: joined paths have no seams to spread")
        if self.style == "spiral" and self.transition == "ramp":
            raise ValueError("a spiral has no ramps: use style contours with transition ramp, or leave transition out")
        return self

    @model_validator(mode="after")
    def _nothing_ignored(self) -> PathSpec:
        """What is written down has to have an effect."""
        needs = {
            "scallop_height": (self.spacing == "scallop", "spacing scallop"),
            "arc_step": (self.spacing == "arc", "spacing arc"),
            "smallest_step": (self.spacing != "depth", "spacing scallop or arc"),
            "largest_step": (self.spacing != "depth", "spacing scallop or arc"),
            "ramp_length": (self.transition == "ramp", "transition ramp"),
            "floor_rounds": (self.floor_step is not None, "floor_step"),
            "sheet_term": ("sheet" in self.compensation, "compensation sheet"),
            "sheet_gain": ("sheet" in self.compensation, "compensation sheet"),
            "machine_error": ("machine" in self.compensation, "compensation machine"),
            "machine_error_tool": ("machine" in self.compensation, "compensation machine"),
        }
        for name in sorted(self.model_fields_set & set(needs)):
            used, need = needs[name]
            if not used:
                raise ValueError(f"{name} has no effect without {need}")
        return self

    def without_effect(self, process: str) -> str | None:
        """What the ``process`` (SPIF, TPIF, DSIF, ADSIF) makes no use of, as a sentence for people, or None."""
        if process != "DSIF" and self.support != "opposite":
            return f"path.support {self.support} needs process DSIF: {process} has no support tool to place"
        if process != "DSIF" and self.squeeze_factor != 1.0:
            return f"path.squeeze_factor needs process DSIF: the gap of {process} does not follow it"
        if process != "DSIF" and self.islands != "around":
            return f"path.islands {self.islands} needs process DSIF: {process} has no second tool that forms"
        if process in ("SPIF", "DSIF"):
            return None
        if self.stages:
            return f"path.stages needs process SPIF or DSIF: {process} forms in one stage"
        if self.floor_step is not None:
            return f"path.floor_step needs process SPIF or DSIF: {process} forms no floor of its own"
        if self.thickness != "sine_law":
            return f"path.thickness {self.thickness} needs process SPIF or DSIF: {process} is planned by the sine law"
        if {"sheet", "tool"} & set(self.compensation):
            return f"path.compensation sheet and tool need process SPIF or DSIF: their models do not hold for {process}"
        if process != "ADSIF":
            return None
        if self.transition != "step" or self.stagger > 0 or self.direction == "alternating":
            return "path.transition, stagger and direction alternating have no effect: ADSIF runs along one spiral"
        if self.style == "contours" and "style" in self.model_fields_set:
            return "path.style contours has no effect: ADSIF runs along one spiral"
        if self.spacing != "depth":
            return f"path.spacing {self.spacing} has no effect: the turns of ADSIF are adsif.pitch apart"
        return None
