"""The rig: clamp, tools' compliance, servo, load cells and limits of one machine.

A rig file may give only what differs from another one: ``based_on`` names the rig (or file) below it. Fields replace
those below, mappings are merged field by field, so that an identified ``servo.bandwidth`` leaves ``servo.rate`` as it
is. What was identified later stands above what was identified before, in as many files as wanted.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, model_validator

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.arm import Arm
from isf_core.files.hexapod import HexapodSetUp
from isf_core.files.hydraulic_legs import HydraulicLegs
from isf_core.files.quantity import (
    Compliance,
    EdgeForce,
    EdgeStiffness,
    Force,
    Frequency,
    Length,
    Speed,
    Stiffness,
    Time,
    Torque,
)
from isf_core.files.spindle_cells import SpindleCells
from isf_core.files.yaml_file import FieldError, FileModel, find_named
from isf_core.geometry.kinematics import Kinematics, make_kinematics
from isf_core.geometry.serial_arm import SerialArm

BASE = "based_on"

MAXIMUM_LAYERS = 20


def layered_text(path: Path) -> tuple[str, list[tuple[str, str]]]:
    """Text of the rig file at ``path`` with everything it is based on, unchanged when it stands alone; and names and
    texts of all these files, the uppermost first.

    Raises IsfError as :func:`isf_core.files.yaml_file.read` and :func:`isf_core.files.yaml_file.content`, and
    FILE_FIELD for files that are based on each other.
    """
    text = yaml_file.read(path)
    layers = []
    here = path
    files = [(str(path), text)]
    while isinstance(layer := yaml_file.content(text, str(here)), dict) and BASE in layer:
        layers.append(layer)
        below = layer.pop(BASE)
        if not isinstance(below, str) or len(layers) > MAXIMUM_LAYERS:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"is {below!r}, or one of more than {MAXIMUM_LAYERS} files that are based on each other",
                where=f"{path}: {BASE}",
                advice="name a rig, or a rig file relative to this one, that is not based on this one",
            )
        here = find_named("rigs", below, here.parent)
        text = yaml_file.read(here)
        files.append((str(here), text))
    if not layers or not isinstance(layer, dict):  # what is no rig is told by the checks of its fields
        return text, [(str(here), text)]
    merged = layer
    for upper in reversed(layers):
        merged = yaml_file.merged(merged, upper)
    for tool in ("tool_1", "tool_2"):
        part = merged.get(tool)
        if isinstance(part, dict) and isinstance(part.get("error_map"), str):
            part["error_map"] = str(_map_path(part["error_map"], tool, here, layer, path))
    return yaml.safe_dump(merged, sort_keys=False, allow_unicode=True, width=10_000), files


def _map_path(name: str, tool: str, lowest: Path, below: dict[str, Any], top: Path) -> Path:
    """A map stands beside the file that names it: the lowest one, unless a layer replaces it."""
    own = below.get(tool)
    return (lowest if isinstance(own, dict) and own.get("error_map") == name else top).parent / name


class Clamp(FileModel):
    """The frame that holds the blank; ``size`` is the free sheet between the clamps (x, y)."""

    size: tuple[Length, Length]
    """Free sheet between the clamps, x and y."""
    height: Length = Field(default=20e-3, ge=0)
    """Frame of the clamp above the sheet, which a forming tool must not run into (assumed where it is left out)."""
    edge: Literal["free", "fixed"] = "free"
    """In-plane condition of the clamped edge (deflection and slope are always held): the
    result depends on it by 20-40 %, so it is a named property of the rig."""
    edge_spring: EdgeStiffness | None = Field(default=None, gt=0, le=1e10)
    """In-plane spring of a free edge: force per displacement and length of edge. Without it only what keeps the sheet
    from drifting."""
    edge_friction: EdgeForce | None = Field(default=None, gt=0)
    """Force per length of edge at which the sheet slides in the clamp; needs ``edge_spring``. Only the elasto-plastic
    sheet slides; the fast sheet has the spring alone."""

    @model_validator(mode="after")
    def _positive(self) -> Clamp:
        if min(self.size) <= 0:
            raise ValueError("size must be positive")
        return self

    @model_validator(mode="after")
    def _edge_law(self) -> Clamp:
        if self.edge == "fixed" and (self.edge_spring is not None or self.edge_friction is not None):
            name = "edge_spring" if self.edge_spring is not None else "edge_friction"
            raise FieldError("a fixed edge does not move", field=f"clamp.{name}", advice="write clamp.edge: free")
        if self.edge_friction is not None and self.edge_spring is None:
            raise FieldError(
                "needs clamp.edge_spring, by which the sheet is held until it slides",
                field="clamp.edge_friction",
                advice="write for example edge_spring: 50 N/mm/mm",
            )
        return self


class LoadCell(FileModel):
    """A six-axis load cell in series with a tool.

    Channels are Fx, Fy, Fz, Mx, My, Mz in axes of frame ``sheet``.
    """

    force_range: tuple[Force, Force, Force]
    """Largest force that is read in x, y and z."""
    resolution: Force = Field(ge=0)
    """Smallest step of a reading."""
    noise_ratio: float = Field(ge=0, lt=0.5)
    """Standard deviation of the noise as a share of the force."""
    noise_floor: Force = Field(ge=0)
    """Standard deviation of the noise of the unloaded cell."""
    crosstalk: float = Field(ge=0, lt=0.5)
    """Largest share of one force channel in another, drawn for each cell; without meaning beside ``matrix``."""
    torque_range: tuple[Torque, Torque, Torque] = (1e3, 1e3, 1e3)
    """Largest torque that is read about x, y and z."""
    torque_noise_floor: Torque = Field(default=0.0, ge=0)
    """Standard deviation of the noise of a torque."""
    matrix: tuple[tuple[float, float, float, float, float, float], ...] | None = None
    """Six rows of six: reading (N and N m) = matrix times load."""
    adc_bits: int | None = Field(default=None, ge=6, le=32)
    """Converter over plus and minus the range of each channel; None: steps of ``resolution``."""
    drift: Force | None = Field(default=None, ge=0)
    """Standard deviation of the slow drift of a force channel; None: the plant's default."""
    drift_time: Time | None = Field(default=None, gt=0)
    """Correlation time of the drift; None: the plant's default."""
    zero_offset: Force | None = Field(default=None, ge=0)
    """Largest reading of the unloaded cell before tare; None: the plant's default."""
    tip_distance: Length = Field(default=0.0, ge=0)
    """From the centre of the cell to the tip of the tool, along the tool; 0: torques are not known and read zero."""

    @model_validator(mode="after")
    def _six_rows(self) -> LoadCell:
        if self.matrix is not None and len(self.matrix) != 6:
            raise ValueError("matrix must have six rows")
        return self


class Servo(FileModel):
    """Position loop of an axis: third order, closed-loop bandwidth at -3 dB, servo rate."""

    bandwidth: Frequency = Field(gt=0.1)
    """Closed loop, -3 dB."""
    rate: Frequency = Field(gt=10)
    """Of the position loop."""
    velocity_feedforward: float = Field(default=0.0, ge=0.0, le=1.5)
    """1: no following error at constant speed."""
    following_error_limit: Length | None = Field(default=None, gt=0)
    """The controller's output saturates at this difference of set-point and position; None: it does not."""


ErrorTable = tuple[tuple[Length, Length], ...]
"""Rows of (commanded position, error there): true = commanded + error, linear between rows, constant beyond."""


class ToolAxis(FileModel):
    """One tool with its axes (x, y, z): compliance, and what its encoders do not see."""

    compliance: tuple[Compliance, Compliance, Compliance]
    """Of the tip in x, y and z."""
    error_x: ErrorTable = ()
    """Error of the axis: rows of commanded position and error, linear between rows."""
    error_y: ErrorTable = ()
    """The same of y."""
    error_z: ErrorTable = ()
    """The same of z."""
    error_map: str | None = None
    """Volumetric error: CSV beside the rig file, columns x, y, z in mm and ex, ey, ez in um on a complete grid."""
    backlash: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Play between encoder and tip."""
    weight: Force = Field(default=0.0, ge=0)
    """Of the tool on its load cell."""
    spindle_cells: SpindleCells | None = None
    """Three tri-axial cells in place of one with six axes: `isf form` and `isf simulate` then read the force from their
    nine voltages."""
    arm: Arm | None = None
    """Of `kinematics: arm`: six-axis arm that carries the tool; `compliance` then is that of tool and holder alone."""

    @model_validator(mode="after")
    def _tables(self) -> ToolAxis:
        for name in ("error_x", "error_y", "error_z"):
            places = [place for place, _ in getattr(self, name)]
            if any(b <= a for a, b in pairwise(places)):
                raise ValueError(f"positions of {name} must rise")
        if min(self.backlash) < 0:
            raise ValueError("backlash must not be negative")
        return self


class Limits(FileModel):
    """Limits that protect the machine; enforced by force_ctrl and again by the machine."""

    travel: tuple[Length, Length, Length]
    """Largest |x|, |y|, |z| of a tool tip."""
    speed: Speed = Field(gt=0)
    """Of a tool tip."""
    force: tuple[Force, Force, Force]
    """Largest |F| per axis."""
    offset: Length = Field(gt=0)
    """Largest offset that force and compliance control may add to a target."""


class Rig(FileModel):
    """One forming machine.

    ``provenance`` tells of every constant whether it is published, calibrated or assumed.
    """

    name: str
    """Name of the machine."""
    clamp: Clamp
    """Frame that holds the blank."""
    tool_1: ToolAxis
    """Upper tool and its axes."""
    tool_2: ToolAxis
    """Lower tool and its axes."""
    contact_stiffness: Stiffness = Field(gt=0)
    """Overall horizontal contact stiffness K_c (Ren 2018 eq. 2-8)."""
    kinematics: Literal["gantry_xyz_uvw", "hexapod_spif_a", "arm"] = "gantry_xyz_uvw"
    """How the axes make a pose of the tips: see isf_core.geometry.kinematics."""
    hexapod: HexapodSetUp = HexapodSetUp()
    """Of `hexapod_spif_a`: table, tool and joints."""
    legs: HydraulicLegs | None = None
    """Of `hexapod_spif_a`: legs that move in the simulated machine, in place of `servo` for the upper tool."""
    servo: Servo
    """Position loop of the axes."""
    load_cell: LoadCell
    """Load cell of each tool."""
    limits: Limits
    """Limits that protect the machine."""
    park_height: Length = Field(gt=0)
    """Tools wait at +park_height (tool_1) and -park_height (tool_2)."""
    scan_place: tuple[Length, Length] | None = None
    """x and y where the tools wait at park height while the sheet is scanned; without it x = 0 and y = 5 mm less than
    the travel, behind the sheet for a scanner in front."""
    provenance: dict[str, str]
    """Constant to its origin: published, calibrated, identified or assumed, with the source."""

    @model_validator(mode="after")
    def _legs_of_a_hexapod(self) -> Rig:
        if self.legs is not None and self.kinematics != "hexapod_spif_a":
            raise FieldError("a gantry has no legs", field="legs", advice="write kinematics: hexapod_spif_a")
        if self.hexapod != HexapodSetUp() and self.kinematics != "hexapod_spif_a":
            raise FieldError("is no hexapod", field="hexapod", advice="write kinematics: hexapod_spif_a")
        return self

    @model_validator(mode="after")
    def _within_travel(self) -> Rig:
        for name, value, most in zip("xy", self.scan_place or (), self.limits.travel, strict=False):
            if not abs(value) <= most - 1e-3:
                raise ValueError(
                    f"scan_place must stay 1 mm within limits.travel, in {name} it is {1e3 * value:g} mm of "
                    f"+-{1e3 * most:g} mm"
                )
        return self

    @model_validator(mode="after")
    def _edge_is_stated(self) -> Rig:
        for name in ("edge_spring", "edge_friction"):
            if getattr(self.clamp, name) is not None and f"clamp.{name}" not in self.provenance:
                raise FieldError(
                    f"provenance is missing for clamp.{name}",
                    field=f"clamp.{name}",
                    advice="write published, calibrated, identified or assumed and the source",
                )
        return self

    @model_validator(mode="after")
    def _arms_of_arms(self) -> Rig:
        if self.kinematics == "arm" and self.tool_1.arm is None:
            raise FieldError("is missing", field="tool_1.arm", advice="describe the arm, or leave kinematics out")
        for name, tool in (("tool_1", self.tool_1), ("tool_2", self.tool_2)):
            if tool.arm is not None and self.kinematics != "arm":
                raise FieldError(
                    f"an arm is of no use to kinematics: {self.kinematics}",
                    field=f"{name}.arm",
                    advice="write kinematics: arm",
                )
        return self

    def make_kinematics(self) -> tuple[Kinematics, Kinematics]:
        """Kinematics of the upper and the lower tool."""
        hexapod = self.hexapod.kinematics() if self.kinematics == "hexapod_spif_a" else None
        return make_kinematics(hexapod or self.arm(1), self.arm(2))

    def with_tool(self, stick_out: float | None) -> Rig:
        """This rig with an upper tool of that length, m, in its chuck; None: with the one that its file has."""
        if stick_out is None or self.kinematics != "hexapod_spif_a":
            return self
        return self.model_copy(update={"hexapod": self.hexapod.model_copy(update={"stick_out": stick_out})})

    def with_force(self, times: float) -> Rig:
        """This rig with ``times`` the force of its limits and of its load cells."""
        limit, reach = (
            tuple(times * newtons for newtons in values) for values in (self.limits.force, self.load_cell.force_range)
        )
        return self.model_copy(
            update={
                "limits": self.limits.model_copy(update={"force": limit}),
                "load_cell": self.load_cell.model_copy(update={"force_range": reach}),
            }
        )

    def arm(self, tool: int) -> SerialArm | None:
        """The arm that carries ``tool`` (1, 2), None where none does."""
        spec = (self.tool_1 if tool == 1 else self.tool_2).arm
        return None if spec is None else spec.kinematics(self.limits.travel, side=1 if tool == 1 else -1)

    @property
    def largest_tilt(self) -> float:
        """rad, by which the machine can tilt its upper tool; 0: it is always upright, as every lower tool is."""
        return self.make_kinematics()[0].tilt_limit

    @property
    def tilt_lever(self) -> float:
        """m, from the tip of the upper tool to the joints that tilt it, at most."""
        return self.make_kinematics()[0].tilt_lever

    @property
    def aside(self) -> tuple[float, float]:
        """x and y, m, where the tools wait during a scan."""
        return self.scan_place or (0.0, self.limits.travel[1] - 5e-3)


def tools_with_spindle_cells(rig: Rig) -> tuple[int, ...]:
    """Numbers of the tools whose force is read from nine voltages."""
    return tuple(k for k, tool in ((1, rig.tool_1), (2, rig.tool_2)) if tool.spindle_cells is not None)


def load_rig(name_or_path: str, base: Path | None = None) -> Rig:
    """Rig by name ("ren2018") or by path relative to ``base``, paths of error maps made absolute; raises IsfError.

    A file may tell only what differs from another rig: see :mod:`isf_core.files.rig`.
    """
    path = find_named("rigs", name_or_path, base).absolute()  # paths of error maps stand on it
    text, files = layered_text(path)
    rig = yaml_file.parse(text, Rig, files[0][0], files)
    tools = {}
    for name in ("tool_1", "tool_2"):
        tool: ToolAxis = getattr(rig, name)
        if tool.error_map is not None:
            tools[name] = tool.model_copy(update={"error_map": str(path.parent / tool.error_map)})
    return rig.model_copy(update=tools)
