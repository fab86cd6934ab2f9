"""Job files: everything that is chosen for one part, section by section.

Sections: part (which CAD surface, in which unit, which way up and where on the blank); blank, tools and what stands
under the sheet; path (how the surface is turned into contours); adsif; control (force and compliance); springback (how
each contour is corrected before it is formed). SI units inside, a number with its unit in the file.

Force rules say where a support force other than the job's holds: by wall, wall angle, corner, depth or place. The
published test of a pyramid asks for 100 to 200 N, different on adjacent walls (Ren 2018, 2.4). What a rule asks for
stands in the contours as their set-points, point by point; force control follows it at its own rate, so a rule that
begins in the middle of a wall needs no ramp.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from isf_core.contour import Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.material import Material, load_material
from isf_core.files.quantity import (
    Acceleration,
    Angle,
    AngularSpeed,
    Force,
    Frequency,
    Length,
    Speed,
    SpindleSpeed,
    Stress,
)
from isf_core.files.rig import Rig, load_rig
from isf_core.files.tooling import BackingPlateSpec, SheetSpec, ToolSpec, with_named_sections
from isf_core.files.yaml_file import FieldError, FileModel
from isf_core.process.support_window import SupportWindow, check_window, support_window
from isf_core.types import Array

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
    """Repair cracks, double and turned facets and holes narrower than the tool, with a warning. False: refuse them."""
    accuracy_surfaces: str | None = None
    """SPIF and DSIF: file made by ``isf learn --surfaces`` from other parts, relative to the job file; the part is
    planned with its target moved against the deviation that is expected of it."""

    @model_validator(mode="after")
    def _unit_declared(self) -> PartSpec:
        if self.unit is None and PurePath(self.mesh).suffix.lower() not in UNIT_IN_FILE:
            raise ValueError(f"unit is missing: '{self.mesh}' carries none; write unit: mm (or m, cm, in)")
        return self


class DieSpec(FileModel):
    """TPIF: a partial or full die under the sheet, as a surface in frame ``sheet`` with the blank holder at its start.

    The clamped sheet moves down over the die with the blank holder; in frame ``sheet`` the die rises.
    """

    mesh: str
    """Path of the mesh of the die's upper surface, relative to the job file."""
    unit: MeshUnit
    """Unit of the coordinates; never guessed."""


class MorphSpec(FileModel):
    """Shapes that are formed before the part, made by morphing it towards the flat blank (Behera 2015)."""

    failure_angle: Angle | None = Field(default=None, gt=0.3, lt=1.5708)
    """Wall angle at which the sheet fails in one pass; None: ``max_wall_angle`` of the material."""
    first_angle: Angle | None = Field(default=None, gt=0.1, lt=1.5708)
    """Of the first shape; None: two thirds of the failure angle (published)."""
    shapes: int | None = Field(default=None, ge=1, le=30)
    """How many shapes before the part; None: as many as the fold-over limit asks for."""
    most_shapes: int = Field(default=12, ge=1, le=30)
    """Without ``shapes``: at most so many."""
    fold_over: Literal["warn", "enforce"] = "warn"
    """Where the next wall is farther away than the tool bridges (Behera 2015 eq. 1): warn, or refuse the plan."""
    gap: Literal["horizontal", "normal"] = "horizontal"
    """Direction in which that distance is measured: the source leaves it open."""
    method: Literal["scaling", "diffusion", "laplacian"] = "diffusion"
    """How the part is morphed: scaling, the part less deep; diffusion, which rounds and gets flatter everywhere; or as
    published, which overshoots."""
    chi: float = Field(default=3e-4, gt=0.0, le=10.0)
    """Method laplacian: weight of the old shape, every node anchored; larger ones give more and smaller steps."""
    joint_width: Length | None = Field(default=None, gt=0.5e-3, lt=0.1)
    """How far from the flange a shape is joined to it by a curve; None: the tool radius."""
    joint_share: float = Field(default=1.0 / 3.0, gt=0.0, le=0.5)
    """Lengths of that curve's outer control lines, over the distance of its ends."""

    @model_validator(mode="after")
    def _nothing_ignored(self) -> MorphSpec:
        if "chi" in self.model_fields_set and self.method != "laplacian":
            raise ValueError("chi has no effect without method laplacian")
        if "most_shapes" in self.model_fields_set and self.shapes is not None:
            raise ValueError("most_shapes has no effect beside shapes")
        if self.first_angle and self.failure_angle and self.first_angle > self.failure_angle:
            raise ValueError("first_angle is steeper than failure_angle, at which the sheet fails in one pass")
        return self


BESIDE_PROGRAM = {"program", "set_up", "incremental_depth", "point_spacing", "feed", "hold_after"}
"""Fields of ``path`` that have an effect beside a program."""


class PathSpec(FileModel):
    """How the surface is turned into contours, or the program that says where the tools go."""

    program: str | None = None
    """SPIF and DSIF: program (G-code), relative to the job file, that is formed as it stands in place of a planned
    path. Beside it `incremental_depth` (0.5 mm) is the step that springback and sheet models count with,
    `point_spacing` (1 mm) the largest distance of points on lines and arcs, `feed` (30 mm/s) what holds until the
    program gives F."""
    set_up: str | None = None
    """Work offsets and tools of the program, relative to the job file; None: those that `isf zero` stored for the rig,
    else none."""
    incremental_depth: Length = Field(gt=0.01e-3, lt=5e-3)
    """Depth from contour to contour; with spacing scallop or arc the largest step unless ``largest_step`` is given."""
    point_spacing: Length = Field(default=0.5e-3, gt=0.05e-3, lt=5e-3)
    """Distance of the points along a contour."""
    feed: Speed = Field(gt=0.1e-3, lt=1.0)
    """Speed of the forming tool along the contour."""
    squeeze_factor: float = Field(default=1.0, gt=0.3, le=1.2)
    """Planned tool gap over predicted thickness; 1 = sine-law gap."""
    hold_after: tuple[int, ...] = ()
    """Contours, counted from 1, after which a part formed through the node graph waits, tools where they are, until
    `executive/go_on` is called."""

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
    morph: MorphSpec | None = None
    """SPIF and DSIF: shapes morphed from the part that are formed before it; ``{}``: all defaults; None: one stage."""
    finishing_passes: int = Field(default=0, ge=0, le=5)
    """SPIF and DSIF: how often the tool passes over the whole part again, on the same path, once it is formed."""
    partial_paths: bool = False
    """SPIF and DSIF: a path for every feature of the surface, with levels of its own under spacing scallop or arc; all
    are merged by depth and start away from ribs."""
    floor_step: Literal["auto", "none"] | Annotated[Length, Field(gt=0.2e-3, lt=0.1)] = "auto"
    """SPIF and DSIF: distance of the rings in which the tool passes over a flat floor after the wall; none: no passes.
    auto: with one tool (SPIF) and a springback correction 0.4 of the radius of the tool, after the part itself, not
    after its preforms; none in all other cases."""
    floor_rounds: Literal["auto"] | Annotated[int, Field(ge=1, le=10)] = "auto"
    """How often the floor is passed over, inwards and outwards in turn; auto: once with `floor_step` auto, else 3
    times."""
    thickness: Literal["sine_law", "overlap"] = "sine_law"
    """How the formed thickness is predicted that the support tool's gap follows."""

    spindle: Literal["none", "rolling"] | Annotated[SpindleSpeed, Field(gt=-5236.0, lt=5236.0)] = "none"
    """Turning of the upper tool in exported programs, while it forms: none; rolling: contour by contour so fast that it
    rolls along the wall (Behera 2015; not ADSIF); or one speed all along, positive clockwise seen from above (M3)."""
    spindle_limit: SpindleSpeed = Field(default=1000.0 * math.pi / 30.0, gt=0.0, lt=5236.0)
    """Spindle rolling: largest speed, which shallow walls ask for (assumed; of the machine)."""

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

    @model_validator(mode="before")
    @classmethod
    def _program_has_its_own(cls, data: Any) -> Any:
        if not isinstance(data, dict) or data.get("program") is None:
            return data
        return {"incremental_depth": "0.5 mm", "point_spacing": "1 mm", "feed": "30 mm/s", **data}

    @model_validator(mode="after")
    def _beside_a_program(self) -> PathSpec:
        if self.program is None and self.set_up is not None:
            raise ValueError("set_up has no effect without program, whose work offsets and tools it holds")
        unused = sorted(self.model_fields_set - BESIDE_PROGRAM)
        if self.program is not None and unused:
            raise ValueError(f"{unused[0]} has no effect beside program, which says where the tools go: leave it out")
        return self

    @model_validator(mode="after")
    def _compensation(self) -> PathSpec:
        if "machine" in self.compensation and self.machine_error is None:
            raise ValueError("compensation machine needs machine_error, the file with the measured errors")
        if len(set(self.compensation)) != len(self.compensation):
            raise ValueError("compensation lists something twice")
        return self

    @model_validator(mode="after")
    def _spindle(self) -> PathSpec:
        if self.spindle == 0.0:
            raise ValueError("spindle 0 rpm does not turn: write spindle: none, or leave it out")
        return self

    @model_validator(mode="after")
    def _stages(self) -> PathSpec:
        angles = (0.0, *self.stages, 0.5 * math.pi)
        if any(later <= earlier for earlier, later in itertools.pairwise(angles)):
            raise ValueError("stages must be ascending wall angles between 0 and 90 deg")
        if self.stages and self.morph is not None:
            raise ValueError("stages and morph both say what is formed before the part: use one of them")
        if self.finishing_passes and self.islands == "swap":
            raise ValueError("finishing_passes needs islands around: what two tools form in turn is formed once")
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
    def _partial_paths(self) -> PathSpec:
        """Partial paths are passes of their own, with a start that follows from the ribs."""
        plain = {"style": "contours", "transition": "step", "stagger": 0.0, "support": "opposite"}
        plain |= {"islands": "around", "thickness": "sine_law"}
        for name, needed in plain.items():
            if self.partial_paths and getattr(self, name) != needed:
                raise ValueError(f"partial_paths needs {name} {needed}")
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
            "floor_rounds": (self.floor_step != "none", "floor_step"),
            "spindle_limit": (self.spindle == "rolling", "spindle rolling"),
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
        if process == "ADSIF" and self.spindle == "rolling":
            return (
                "path.spindle rolling needs process SPIF, DSIF or TPIF: in ADSIF the wall is not where the tool touches"
            )
        if process in ("SPIF", "DSIF"):
            return None
        if self.stages:
            return f"path.stages needs process SPIF or DSIF: {process} forms in one stage"
        if self.morph is not None:
            return f"path.morph needs process SPIF or DSIF: {process} forms in one stage"
        if self.finishing_passes:
            return f"path.finishing_passes needs process SPIF or DSIF: {process} forms in one pass"
        if self.partial_paths:
            return f"path.partial_paths needs process SPIF or DSIF: {process} has no passes over single features"
        if self.floor_step not in ("auto", "none"):
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


class ToolAxisSpec(FileModel):
    """How the upper tool is tilted along the path (Torrao 2013, 6.2.3); for a hemispherical tip."""

    strategy: Literal["vertical", "five_axis", "auto"] = "vertical"
    """vertical: upright; five_axis: towards the sheet's normal by the wall angle, at most ``largest_tilt``; auto:
    five_axis on a rig that can tilt its tool as far as that asks for, or less, and vertical on the others."""
    largest_tilt: Angle = Field(default=math.radians(30.0), gt=0.0, le=math.radians(60.0))
    """Between tool axis and vertical (published: 30 deg)."""
    largest_rate: AngularSpeed = Field(default=math.radians(10.0), gt=0.0, le=10.0)
    """Of the turning axis, for which the feed is lowered. Assumed: the platform of the SPIF-A, which turns about a tip
    438 mm below it (a tool of 100 mm), then moves at 76 mm/s; its cylinders can do 100 mm/s."""
    smoothing: Length = Field(default=10e-3, ge=1e-3, lt=0.2)
    """Length of path over which the axis is averaged: a corner of the wall is no jump of the axis (assumed)."""

    @model_validator(mode="after")
    def _nothing_ignored(self) -> ToolAxisSpec:
        for name in ("largest_tilt", "largest_rate", "smoothing"):
            if name in self.model_fields_set and self.strategy == "vertical":
                raise ValueError(f"{name} has no effect without strategy five_axis or auto")
        return self


class AdsifSpec(FileModel):
    """How position angle and gap of the tools are chosen (Ren 2018, chapter 3)."""

    surface: str = "AA5754-O_1mm_R5"
    """Response surface: a name in ``share/isf_core/adsif`` or a path relative to the job file."""
    pitch: Length = Field(default=0.2e-3, gt=0.01e-3, lt=2e-3)
    """Horizontal distance between two turns of the spiral."""
    projection_distance: Length | None = Field(default=None, gt=0.1e-3, lt=10e-3)
    """Depth of the forming tip below the blank's upper face, constant; None: that of the surface."""
    policy: Literal["variation", "force", "trade_off", "continuity"] = "trade_off"
    """Which pair of position angle and gap is taken where several form the wall."""
    largest_variation: Angle = Field(default=math.radians(5.0), gt=0.0, lt=1.0)
    """Policy trade_off: largest angle variation at which the smallest force is looked for."""
    compensate_compliance: bool = True
    """Command the gap smaller by what the rig's tools give way under the predicted force (Ren 2018 eq. 3-12)."""


RuleForce = Annotated[Force, Field(gt=0.0, le=1500.0)]


class ForceRule(FileModel):
    """One rule; it holds where all of its conditions hold, ends of a range included."""

    force: RuleForce
    """Set-point of the horizontal normal force there."""
    facing: tuple[Angle, Angle] | None = None
    """Direction of the outward normal in the plane, from x towards y, counter-clockwise from one to the other."""
    wall_angle: tuple[Angle, Angle] | None = None
    """Angle of the wall from the horizontal."""
    corner_radius: tuple[Length, Length] | None = None
    """Radius of the forming tool's path in the plane, not of the part; straight lines are in no range."""
    depth: tuple[Length, Length] | None = None
    """Of the forming tip below (or, formed from below, above) the blank."""
    x: tuple[Length, Length] | None = None
    """Of the forming tip."""
    y: tuple[Length, Length] | None = None
    """Of the forming tip."""

    @model_validator(mode="after")
    def _says_where(self) -> ForceRule:
        ranges = {name: getattr(self, name) for name in ("wall_angle", "corner_radius", "depth", "x", "y")}
        if self.facing is None and not any(ranges.values()):
            raise ValueError("the rule names no place: give facing, wall_angle, corner_radius, depth, x or y")
        for name, limits in ranges.items():
            if limits is not None and not limits[0] < limits[1]:
                raise ValueError(f"{name} must go from a smaller to a larger value")
            if limits is not None and name in ("wall_angle", "corner_radius", "depth") and limits[0] < 0.0:
                raise ValueError(f"{name} is never negative: begin at 0")
        turn = 2.0 * math.pi + 1e-9
        for name in ("facing", "wall_angle"):
            limits = getattr(self, name)
            if limits is not None and max(abs(limits[0]), abs(limits[1])) > turn:
                raise ValueError(f"{name} must lie within -360 and 360 deg")
        if self.facing is not None:
            begin, end = self.facing
            if math.isclose(begin, end, abs_tol=1e-9):
                raise ValueError("facing begins where it ends: give a range, or leave it out for all directions")
        return self


@dataclass(frozen=True)
class WallFacts:
    """What rules ask about the N points of a contour.

    Attributes
    ----------
    facing : (N,) rad, direction of the horizontal outward normal ; wall_angle : (N,) rad ; corner_radius : (N,) m,
        infinite on straight lines ; depth : (N,) m ; x, y : (N,) m
    """

    facing: Array
    wall_angle: Array
    corner_radius: Array
    depth: Array
    x: Array
    y: Array


def ruled_forces(rules: Sequence[ForceRule], force: float, facts: WallFacts) -> Array:
    """(N,) N: ``force``, and where a rule holds the rule's; of several the last one."""
    wanted = np.full(len(facts.facing), force)
    for rule in rules:
        wanted[holds(rule, facts)] = rule.force
    return wanted


def holds(rule: ForceRule, facts: WallFacts) -> NDArray[np.bool_]:
    """(N,) where all conditions of ``rule`` hold."""
    where = np.ones(len(facts.facing), dtype=bool)
    if rule.facing is not None:
        begin, end = rule.facing
        turn = 2.0 * math.pi
        span = (end - begin) % turn or turn  # from -180 to 180 deg is all round; equal ends are refused
        where &= np.mod(facts.facing - begin, turn) <= span
    for name in ("wall_angle", "corner_radius", "depth", "x", "y"):
        limits = getattr(rule, name)
        if limits is not None:
            value = getattr(facts, name)
            where &= (value >= limits[0]) & (value <= limits[1])
    return where


LARGEST_SUPPORT_FORCE = 1500.0
"""N, that a job or a run may ask for."""
SupportForce = Annotated[Force, Field(ge=0.0, le=LARGEST_SUPPORT_FORCE)]


class ControlSpec(FileModel):
    """Force and compliance control."""

    rate: Frequency = Field(default=500.0, ge=100.0, le=2000.0)
    """Rate f_s of wrenches and targets."""
    support_force: Literal["auto"] | SupportForce = 0.0
    """Set-point of the horizontal normal force on the support tool; 0 = position control, ``auto`` = from sheet, tools,
    rig and wall angle (:mod:`isf_core.process.support_window`). Left out it is ``auto`` in DSIF, unless path.support is
    on_blank, else 0."""
    force_rules: tuple[ForceRule, ...] = ()
    """Other set-points on some walls, corners, depths or places (:mod:`isf_core.files.job`); the last rule that holds
    counts. They need a support_force, which holds elsewhere."""
    engage_depth: Length = Field(default=0.0, ge=0.0)
    """Force control acts on contours at least this deep: not on the entry fillet (Ren 2018, 2.4.1)."""
    engage_wall_angle: Angle = Field(default=math.radians(15.0), ge=0.0, lt=1.5708)
    """Force control acts on contours at least this steep: on flat sheet the horizontal normal force has no
    authority (Ren 2018, section 2.4); the default is assumed."""
    compliance_compensation: float = Field(default=1.0, ge=0.0, le=1.0)
    """Factor on the compliance compensation of the forming tool."""
    support_compensation: float | None = Field(default=None, ge=0.0, le=1.0)
    """Factor on the compliance compensation of the support tool, on contours without force control. None: as much as
    is stable in ADSIF, where no wall guides the tools (Ren 2018, 3.3.1), nothing in other processes."""

    components: tuple[Literal["normal", "vertical", "tangential"], ...] = ("normal",)
    """Which components of the force on the support tool are controlled; the horizontal normal one always is. Vertical
    and tangential turn the line of the ball centres, slowly and within small offsets."""
    vertical_force: Force | None = Field(default=None, ge=0.0, le=1500.0)
    """Set-point of the vertical component, positive in compression; None: that of a contact without friction, the
    normal one times the cotangent of the wall angle."""
    tangential_force: Force = Field(default=0.0, ge=-500.0, le=500.0)
    """Set-point of the tangential component, along the outward normal turned by +90 deg about z."""

    @model_validator(mode="after")
    def _components_with_set_points(self) -> ControlSpec:
        if "normal" not in self.components:
            raise ValueError("components must hold normal: the other components turn a force whose size it controls")
        if "vertical" not in self.components and self.vertical_force is not None:
            raise ValueError("vertical_force has no effect unless components holds vertical")
        if "tangential" not in self.components and self.tangential_force != 0.0:
            raise ValueError("tangential_force has no effect unless components holds tangential")
        return self

    @model_validator(mode="after")
    def _rules_with_force(self) -> ControlSpec:
        if self.force_rules and not self.force_controlled:
            raise ValueError("force_rules have no effect unless support_force is a force or auto")
        return self

    @property
    def force_controlled(self) -> bool:
        """True when the support tool is to be force-controlled at all."""
        return self.support_force == "auto" or self.support_force > 0.0


class MpcSpec(FileModel):
    """Model-predictive control from scans; the defaults are those of Lu 2016 (Tables 3-5) unless said otherwise."""

    horizon: int = Field(default=6, ge=0, le=100)
    """Contours looked ahead; 0: to the end of the part."""
    vertical_weight: float = Field(default=0.2, ge=0.0, le=100.0)
    """lambda_z, damps the step depth."""
    horizontal_weight: float = Field(default=0.7, ge=0.0, le=100.0)
    """lambda_h, holds the horizontal increment near the planned one."""
    smallest_step: float = Field(default=0.5, gt=0.0, le=1.0)
    """Smallest step depth, in planned steps."""
    largest_step: float = Field(default=2.0, gt=1.0, le=10.0)
    """Largest step depth, in planned steps; above 1, or a lag could never be made good."""
    horizontal_change: Length = Field(default=0.5e-3, gt=0.0, lt=5e-3)
    """Largest departure e of a horizontal increment from the planned one."""
    largest_offset: Length = Field(default=10e-3, gt=0.0, lt=30e-3)
    """Largest departure from the planned path in all (assumed)."""
    reference_angles: tuple[Angle, ...] = (math.radians(45.0),)
    """Directions whose section is optimised, seen from the middle of the contour; one is published for the pyramid,
    five (0, 45, 90, 180, 270 deg) for the asymmetric cone."""
    distribution: Literal["none", "uniform", "interpolated", "dense"] = "interpolated"
    """Horizontal springback between the reference directions; dense: every direction is measured and optimised."""
    step: Literal["common", "per_direction"] = "common"
    """One step depth for the whole contour (published), or one for every direction."""
    coupled: bool = False
    """Optimise step depth and horizontal increment in one problem, with slope and offset as constraints."""
    solver: Literal["scipy", "piqp"] = "scipy"
    """Solver of the quadratic programs; piqp is an optional package."""

    @model_validator(mode="after")
    def _directions(self) -> MpcSpec:
        if not self.reference_angles:
            raise ValueError("reference_angles needs one direction or more")
        return self


class ElasticSpec(FileModel):
    """Method "elastic": shell model of the partly formed sheet at few control points (Ren 2018, 4.2 and 4.3)."""

    database: str | None = None
    """File made by ``isf springback database``, relative to the job file; without it the user's cache is looked into,
    and what is not there is computed while forming."""
    edge_slope: Literal["clamped", "supported"] = "clamped"
    """Slope of the sheet at the clamp: held, or free."""
    edge_stiffness: Stress | None = Field(default=None, ge=0.0)
    """In-plane spring of the clamped edge, force per displacement and length; ``isf springback calibrate`` finds it
    from a push on the flat sheet. Without it the edge is free or immovable as the rig says."""
    loop_increment: Length = Field(default=1e-3, gt=0.0)
    """Depth between control loops (published)."""
    largest_load: Force = Field(default=1000.0, gt=10.0)
    """Largest load of the samples; published 600 N, which the forces of deep cones exceed."""
    engine: Literal["compact", "kratos"] = "compact"
    """What computes the samples of a database and ``predict``: the shell of this package, or KratosMultiphysics, which
    is installed by itself, takes some twenty times as long and gives the same. While forming it is the former."""
    forecast: Literal["hold", "half_step", "linear"] = "hold"
    """Force forecast; half_step is the published 1.5 F_(i-1) - 0.5 F_(i-2). The more a forecast runs ahead, the more
    the force that a deeper push raises swings the next push: see docs/methods/springback.md."""
    block: int = Field(default=1, ge=1)
    """Contours per force forecast (published: 5)."""
    horizontal: bool = False
    """Correct across the wall as well, from the measured horizontal force (left uncorrected in the source); the laws
    are computed while forming, about a second per ``loop_increment``."""


class FusedSpec(FileModel):
    """Method "fused": prediction of a model and bias from the scanned shape as one estimate."""

    model: Literal["analytic", "elastic"] = "elastic"
    """What predicts from the force; elastic takes its options from the section ``elastic``."""


class SpringbackSpec(FileModel):
    """Correction of each contour before it is formed."""

    method: str = "auto"
    """Name of a method of isf_springback ("none", "analytic", ...). auto is one of them: in SPIF and DSIF `elastic`,
    with `scan_every` `fused`, with `learning` `learned`; in TPIF with `scan_every` `mpc_tpif`;
    `none` in all other cases, beside `path.compensation: [sheet]`, and for a program, which is formed as it stands."""
    gain: float = Field(default=1.0, ge=0.0, le=2.0)
    """Factor on the predicted springback; not on the push that `learned` replays."""
    first_contour: Literal["predicted", "zero"] = "predicted"
    """Contours before which no force was measured, with `elastic.block` the whole first block: corrected for the force
    that the plan predicts (methods with a model of the sheet), or not corrected, as published (Ren 2018, 4.3.1). Left
    out it is ``zero`` with path.support on_blank, whose support tool holds the sheet there: a push would only bend
    it."""
    scan_every: int = Field(default=0, ge=0)
    """The shape is measured after every so many contours, for methods that use it; 0: never."""
    scan_clear: bool = True
    """Both tools are lifted clear and moved aside before a scan, and approach the sheet again after it; otherwise the
    scan is made with the tools where the contour ended, and what they hide is a hole in it. Open contours (spirals)
    are always scanned so: a tool lifted off in the middle of one leaves a mark."""
    lift_every: Literal["auto"] | Annotated[int, Field(ge=0)] = "auto"
    """The forming tool is lifted after the first contour and after every so many, and measures springback where it
    stands, for methods that use it; 0: never. auto: 4 where `elastic` corrects a part of SPIF or DSIF made of separate
    contours, else 0."""
    scan_sensor: bool = False
    """Simulated machine: scans as a scanner sees the part (noise, holes, registration) instead of exact ones."""
    open_loop_contours: int = Field(default=3, ge=0)
    """Contours at the start of every feature and stage whose shape is too shallow to be used (published: 3, Lu 2016,
    4.2.1)."""
    mpc: MpcSpec = MpcSpec()
    """Of the methods mpc_...."""
    elastic: ElasticSpec = ElasticSpec()
    """Of the method elastic."""
    fused: FusedSpec = FusedSpec()
    """Of the method fused."""
    learning: str | None = None
    """Correction file made by ``isf learn`` from parts formed before, or by ``isf tryout``, relative to the job file.
    With `scan_every`, scans correct what they show to be different from that part."""


class ToleranceSpec(FileModel):
    """What the finished part is judged by."""

    shape: Length = Field(default=0.3e-3, gt=1e-6, lt=0.1)
    """Largest vertical error of a good point; the default is the band of Lu 2016, 4.4."""
    share: float = Field(default=0.9, gt=0.0, le=1.0)
    """Of the points of wall and base that must be good; 1: all of them. The default is that of Lu 2016, 4.4."""


FLOOR_STEP = 0.4
"""Distance of the passes over a floor over the radius of the tool, where the job leaves it open."""
LEAST_FLOOR_STEP = 0.25e-3
"""m, smallest distance of these passes, of the smallest tools."""


LIFT_EVERY = 4
"""Contours between two tool lifts where the job leaves it open: without scans, lifts are all that tells how far a sheet
springs back (docs/results/index.md has what a part gains)."""

AUTO = "auto"
"""Springback method that stands for another one, see :func:`springback_method`."""


def springback_method(job: Job, name: str | None = None) -> str:
    """Name of the springback method of ``job`` where ``name`` is asked for: auto, another one, or empty: the job's."""
    if name != AUTO:
        return name or job.springback.method
    spec = job.springback
    if job.path.program is not None or job.strategy or "sheet" in job.path.compensation:
        return "none"
    if job.process in ("SPIF", "DSIF"):
        return "learned" if spec.learning else "fused" if spec.scan_every else "elastic"
    return "mpc_tpif" if job.process == "TPIF" and spec.scan_every else "none"


def lift_interval(job: Job, method: str | None = None) -> int:
    """Contours from one tool lift to the next in a run with ``method`` (None or empty: the job's), 0: no lifts."""
    every = job.springback.lift_every
    if every != "auto":
        return every
    fits = job.process in ("SPIF", "DSIF") and job.path.style == "contours"
    return LIFT_EVERY if fits and springback_method(job, method) == "elastic" else 0


def floor_step(job: Job, *, preform: bool = False) -> float | None:
    """m, distance of the rings in which the tool passes over the floors of the part, or of a ``preform``; None: it does
    not."""
    step = job.path.floor_step
    if step != "auto":
        return None if step == "none" else step
    wanted = job.process == "SPIF" and job.path.program is None and job.springback.method != "none"
    return max(FLOOR_STEP * job.tool_1.radius, LEAST_FLOOR_STEP) if wanted and not preform else None


def floor_rounds(job: Job) -> int:
    """How often the tool passes over a floor, where it does."""
    rounds = job.path.floor_rounds
    if rounds != "auto":
        return rounds
    return 1 if job.path.floor_step == "auto" else 3


def correction_refusal(process: str, method: str) -> str:
    """Why ``method`` cannot correct parts of ``process``, one sentence; empty: it can."""
    if process != "ADSIF" or method == "none":
        return ""
    return f"process ADSIF forms at a constant depth: {method} would push both tools off the plane they must stay in"


BUILT_IN = ("SPIF", "TPIF", "DSIF", "ADSIF")
"""Processes that machine, force control and simulated sheet know."""

PROCESSES = "isf.processes"
"""Entry points of processes: classes of the planner, or of a package beside it."""


@cache
def _registered() -> dict[str, EntryPoint]:
    """Processes by name; looked up once, since that reads the metadata of all packages."""
    return {entry.name: entry for entry in entry_points(group=PROCESSES)}


def process_names() -> list[str]:
    """Names of all processes that are installed, sorted."""
    return sorted({*BUILT_IN, *_registered()})


def load_process(name: str) -> Any:
    """The class registered as process ``name``; raises IsfError FILE_FIELD when it is missing or cannot be loaded."""
    found = _registered().get(name)
    try:
        return _registered()[name].load()
    except Exception as error:  # a process of another package may fail in any way while it is loaded
        why = f"{type(error).__name__}: {error}" if found else "no package registers it"
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"the process {name} cannot be loaded: {why}",
            where=found.value if found else "process",
            advice=f"known: {', '.join(process_names())}",
        ) from error


def _installed(name: Any) -> Any:
    """Of another package's process its kind stands here already."""
    if isinstance(name, str) and name not in BUILT_IN:
        raise ValueError(f"no installed package has the process {name}; known: {', '.join(process_names())}")
    return name


class Job(FileModel):
    """One part to be formed."""

    name: str = Field(min_length=1, max_length=80, pattern=r"^[A-Za-z0-9_.-]+$")
    """Name of the part: letters, digits, dot, dash and underscore; runs and reports carry it."""
    part: PartSpec | None = None
    """The CAD surface; only beside `path.program` it may be left out, and is else what the formed part is held
    against."""
    process: Annotated[Literal["SPIF", "TPIF", "DSIF", "ADSIF"], BeforeValidator(_installed)]
    """How it is formed, or the name of a process of another package."""
    rig: str
    """Machine file by name, or a path relative to the job file."""
    sheet: SheetSpec
    """The blank: its fields, or the name of one in the library, or a path relative to the job file."""
    tool_1: ToolSpec
    """Upper tool: its fields, or a name or path as of a blank."""
    tool_2: ToolSpec | None = None
    """Lower tool, as the upper one; needed by DSIF and ADSIF."""
    backing_plate: BackingPlateSpec | None = None
    """Plate under the sheet around the opening: its fields, or a name or path as of a blank; left out: none."""
    die: DieSpec | None = None
    """What the sheet is formed onto; TPIF only, and needed there."""
    path: PathSpec
    """How the surface becomes contours."""
    tool_axis: ToolAxisSpec = ToolAxisSpec()
    """Tilt of the upper tool along the path."""
    adsif: AdsifSpec | None = None
    """Of accumulative forming; ADSIF only."""
    control: ControlSpec = ControlSpec()
    """Force and compliance control."""
    springback: SpringbackSpec = SpringbackSpec()
    """Correction of contours before they are formed."""
    tolerance: ToleranceSpec = ToleranceSpec()
    """What the finished part is judged by."""
    strategy: str = ""
    """Process of another package that plans the contours; ``process: NAME`` sets it, and its kind as the process."""
    wall_angle_limit: Angle | None = Field(default=None, gt=0.0, lt=1.5708)
    """Largest wall angle that may be planned, in place of what one pass and each further one may add by the material;
    what the sheet bears does not change."""
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
    def _correction(self) -> Job:
        if self.springback.method != AUTO:
            return self
        spec = self.springback.model_copy(update={"method": springback_method(self, AUTO)})
        return self.model_copy(update={"springback": spec})

    @model_validator(mode="after")
    def _path_of_process(self) -> Job:
        if problem := self.path.without_effect(self.process):
            raise ValueError(problem)
        if "floor_rounds" in self.path.model_fields_set and floor_step(self) is None:
            raise ValueError(
                "path.floor_rounds has no effect without floor_step: give it a distance; auto plans no passes with two "
                "tools, or without a correction"
            )
        if self.accuracy_surfaces is not None and self.process not in ("SPIF", "DSIF"):
            raise ValueError(f"part.accuracy_surfaces needs process SPIF or DSIF: nothing is learned of {self.process}")
        if self.path.support == "on_blank" and self.control.force_controlled:
            raise ValueError("path.support on_blank has no force control: control.support_force must be 0 N")
        if self.support_stays and self.springback.first_contour == "predicted":
            raise ValueError(
                "path.support on_blank holds the sheet under the first contour: first_contour must be zero"
            )
        if self.support_stays and "sheet" in self.path.compensation:
            raise FieldError(
                "sheet computes the deflection of a sheet that the clamp or a plate alone holds, not one that "
                "path.support on_blank holds at the opening",
                field="path.compensation",
                advice="leave sheet out: springback.method corrects what is measured",
            )
        return self

    @model_validator(mode="after")
    def _part_or_program(self) -> Job:
        if self.path.program is None:
            if self.part is None:
                raise FieldError(
                    "part is missing",
                    field="part",
                    advice="write part: {mesh: FILE, unit: mm}, or path: {program: FILE} for a program that is formed",
                )
            return self
        if self.strategy or self.process not in ("SPIF", "DSIF"):
            raise FieldError(
                f"a program is formed by process SPIF or DSIF, not {self.strategy or self.process}",
                field="path.program",
                advice="write process: SPIF for one tool, DSIF for two",
            )
        if self.control.force_controlled:
            raise FieldError(
                "a program holds no support forces: the lower tool is under position control",
                field="control.support_force",
                advice="leave it out or write 0 N",
            )
        if self.accuracy_surfaces is not None:
            raise FieldError(
                "a program is formed as it stands: nothing moves its target",
                field="part.accuracy_surfaces",
                advice="leave it out",
            )
        if self.tool_axis.model_fields_set:
            raise FieldError(
                "a program says itself how the tool is tilted", field="tool_axis", advice="leave the section out"
            )
        return self

    @model_validator(mode="after")
    def _axis_of_process(self) -> Job:
        if self.tool_axis.strategy != "five_axis":
            return self
        if self.process not in ("SPIF", "DSIF"):
            raise FieldError(
                f"process {self.process} forms with upright tools",
                field="tool_axis.strategy",
                advice="write vertical or auto, or use process SPIF or DSIF",
            )
        if self.tool_1.flat_radius > 0.0:
            raise FieldError(
                "a flat tip cannot be tilted: it would stand on its edge",
                field="tool_axis.strategy",
                advice="use a hemisphere (leave tool_1.corner_radius out), or write vertical",
            )
        return self

    @model_validator(mode="after")
    def _constant_depth(self) -> Job:
        if self.process != "ADSIF":
            return self
        if self.springback.method != "none":
            raise FieldError(
                correction_refusal(self.process, self.springback.method),
                field="springback.method",
                advice="leave it out or write none",
            )
        if self.control.force_controlled:
            raise FieldError(
                "process ADSIF has no force control: gap and position angle of its response surface set the force",
                field="control.support_force",
                advice="leave it out or write 0 N; adsif.policy chooses how large the force is",
            )
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
        if "machine" in wanted and (self.tool_2 is None or self.process not in ("DSIF", "ADSIF")):
            raise ValueError("path.compensation machine needs two tools: it corrects the distance between them")
        return self

    @model_validator(mode="before")
    @classmethod
    def _support_force_left_out(cls, data: Any) -> Any:
        """A support tool that nothing presses on the sheet is not left to chance: see ``ControlSpec.support_force``."""
        if not isinstance(data, dict) or data.get("process") != "DSIF":
            return data
        control, path = data.get("control", {}), data.get("path", {})
        no_force = isinstance(path, dict) and (path.get("support") == "on_blank" or path.get("program") is not None)
        if no_force or not isinstance(control, dict) or "support_force" in control:
            return data
        return {**data, "control": {**control, "support_force": "auto"}}

    @model_validator(mode="before")
    @classmethod
    def _first_contour_left_out(cls, data: Any) -> Any:
        """See ``SpringbackSpec.first_contour``."""
        path = data.get("path") if isinstance(data, dict) and data.get("process") == "DSIF" else None
        if not isinstance(path, dict) or path.get("support") != "on_blank":
            return data
        springback = data.get("springback", {})
        if not isinstance(springback, dict) or "first_contour" in springback:
            return data
        return {**data, "springback": {**springback, "first_contour": "zero"}}

    @model_validator(mode="before")
    @classmethod
    def _own_process(cls, data: Any) -> Any:
        """A process of another package: its kind is the process, its name the strategy. The last one runs first."""
        name = data.get("process") if isinstance(data, dict) else None
        if not isinstance(name, str) or name in BUILT_IN or name not in process_names():
            return data  # an unknown one is told with its place by _installed
        kind = getattr(load_process(name), "kind", None)
        if kind not in BUILT_IN:
            raise ValueError(f"the process {name} has the kind {kind!r}: it must be one of {', '.join(BUILT_IN)}")
        return {**data, "process": kind, "strategy": name}

    @property
    def support_stays(self) -> bool:
        """Whether the support tool stays under the blank, where no correction moves it."""
        return self.process == "DSIF" and self.path.support == "on_blank"

    @property
    def force_refusal(self) -> str:
        """Why no force can be held on the support tool, for a sentence; empty: it can."""
        if self.process in ("SPIF", "TPIF"):
            return f"process {self.process} has no support tool"
        if self.process == "ADSIF":
            return "process ADSIF has no force control"
        return "path.support on_blank has no force control" if self.path.support == "on_blank" else ""

    def check_set_point(self, force: float | None, *, where: str, advice: str) -> None:
        """Raise IsfError FILE_FIELD for a set-point of ``force`` N in place of the job's that no force control holds.

        None: the job's; 0: position control. ``where``: the option or field of the set-point.
        """
        if force and (refusal := self.force_refusal):
            raise IsfError(ErrorCode.FILE_FIELD, f"{refusal}: {force:g} N cannot be held", where=where, advice=advice)

    @property
    def accuracy_surfaces(self) -> str | None:
        """File of accuracy surfaces that move the target, None without."""
        return None if self.part is None else self.part.accuracy_surfaces

    @property
    def place(self) -> tuple[float, float] | None:
        """m, x and y of the outline's centre on the blank; None: the centre of the blank."""
        return None if self.part is None else self.part.place

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
    job : Job ; material : Material ; rig : Rig, with the job's upper tool in its chuck
    rig_force : (3,) N, force limit of the rig as its file has it
    force_raised : limits and load cells of ``rig`` are so many times those of its file (:meth:`with_force_raised`)
    mesh : absolute path of the mesh, None for a program without a part
    program : absolute path of the program that is formed, None where the path is planned
    text : the YAML text as read, with the fields of tools, blank and plate where it names their files
    base : folder that relative paths refer to
    """

    def __init__(self, text: str, base: Path, name: str = "job") -> None:
        self.text = with_named_sections(text, base, name)
        self.base = base
        self.job: Job = yaml_file.parse(self.text, Job, name, [(name, text)])
        self.material: Material = load_material(self.job.sheet.material, base)
        self.rig: Rig = load_rig(self.job.rig, base).with_tool(self.job.tool_1.stick_out)
        self.rig_force = self.rig.limits.force
        self.force_raised = 1.0
        _check_blank(self, text, name)
        self.job._support_window = _support_window(self)
        part, program = self.job.part, self.job.path.program
        self.mesh: Path | None = None if part is None else (base / part.mesh).resolve()
        self.program: Path | None = None if program is None else (base / program).resolve()

    @property
    def sources(self) -> tuple[Path, ...]:
        """What the path comes from: mesh and program, as far as there are."""
        return tuple(path for path in (self.mesh, self.program) if path is not None)

    def changed(self, change: Mapping[str, Any], name: str = "job") -> JobFile:
        """This job with the fields of ``change`` in place of its own, section by section; one that is null is left out.

        Raises IsfError as of a job file; ``name`` of it in errors.
        """
        fields = yaml_file.merged(yaml_file.content(self.text, name), change)
        return JobFile(yaml.safe_dump(fields, sort_keys=False), self.base, name)

    def with_force_raised(self, times: float) -> JobFile:
        """This job on its machine with ``times`` the force, of limits and load cells; one of such a job is itself."""
        if times == 1.0 or self.force_raised != 1.0:
            return self
        stronger = copy.copy(self)
        stronger.rig, stronger.force_raised = self.rig.with_force(times), times
        return stronger

    @property
    def tilts(self) -> bool:
        """True when the upper tool is tilted along the path: asked for, and not left out on a rig that cannot. Of a
        program it is not known before it is read: True where the rig can."""
        if self.program is not None:
            return self.rig.largest_tilt > 0.0
        strategy = self.job.tool_axis.strategy
        fits = self.job.tool_1.flat_radius == 0.0 and self.job.process in ("SPIF", "DSIF")
        return strategy == "five_axis" or (strategy == "auto" and fits and self.rig.largest_tilt > 0.0)


def _check_blank(job_file: JobFile, text: str, name: str) -> None:
    """Raises IsfError FILE_FIELD for a blank that the clamp cannot hold; ``text`` and ``name`` of the job."""
    size, free = job_file.job.sheet.size, job_file.rig.clamp.size
    if size is None or (size[0] >= free[0] and size[1] >= free[1]):
        return
    blank, clamp = (" x ".join(f"{1e3 * side:g}" for side in sides) for sides in (size, free))
    raise IsfError(
        ErrorCode.FILE_FIELD,
        f"the blank of {blank} mm does not reach the clamp of {job_file.rig.name}, {clamp} mm apart",
        where=f"{name}:{yaml_file.line_of(text, ('sheet', 'size'))}",
        advice="take a larger blank, or a rig with a smaller clamp.size",
    )


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
