"""The rig: clamp, tools' compliance, servo, load cells and limits of one machine."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from isf_core import yaml_file
from isf_core.model_base import FileModel
from isf_core.quantity import Compliance, Force, Frequency, Length, Speed, Stiffness
from isf_core.shared_files import find_named


class Clamp(FileModel):
    """The frame that holds the blank; ``size`` is the free sheet between the clamps (x, y)."""

    size: tuple[Length, Length]
    edge: Literal["free", "fixed"] = "free"
    """In-plane condition of the clamped edge (deflection and slope are always held): the
    result depends on it by 20-40 %, so it is a named property of the rig."""

    @model_validator(mode="after")
    def _positive(self) -> Clamp:
        if min(self.size) <= 0:
            raise ValueError("size must be positive")
        return self


class LoadCell(FileModel):
    """A six-axis load cell in series with a tool."""

    force_range: tuple[Force, Force, Force]
    resolution: Force = Field(ge=0)
    noise_ratio: float = Field(ge=0, lt=0.5)
    noise_floor: Force = Field(ge=0)
    crosstalk: float = Field(ge=0, lt=0.5)


class Servo(FileModel):
    """Position loop of an axis: third order, closed-loop bandwidth at -3 dB, servo rate."""

    bandwidth: Frequency = Field(gt=0.1)
    rate: Frequency = Field(gt=10)


class ToolAxis(FileModel):
    """Compliance of one tool with its axes (x, y, z)."""

    compliance: tuple[Compliance, Compliance, Compliance]


class Limits(FileModel):
    """Limits that protect the machine; enforced by force_ctrl and again by the machine."""

    travel: tuple[Length, Length, Length]
    """Largest |x|, |y|, |z| of a tool tip."""
    speed: Speed = Field(gt=0)
    force: tuple[Force, Force, Force]
    """Largest |F| per axis."""
    offset: Length = Field(gt=0)
    """Largest offset that force and compliance control may add to a target."""


class Rig(FileModel):
    """One forming machine.

    ``provenance`` tells of every constant whether it is published, calibrated or assumed.
    """

    name: str
    clamp: Clamp
    tool_1: ToolAxis
    tool_2: ToolAxis
    contact_stiffness: Stiffness = Field(gt=0)
    """Overall horizontal contact stiffness K_c (Ren 2018 eq. 2-8)."""
    servo: Servo
    load_cell: LoadCell
    limits: Limits
    park_height: Length = Field(gt=0)
    """Tools wait at +park_height (tool_1) and -park_height (tool_2)."""
    provenance: dict[str, str]


def load_rig(name_or_path: str, base: Path | None = None) -> Rig:
    """Rig by name ("ren2018") or by path relative to ``base``; raises IsfError."""
    return yaml_file.load(find_named("rigs", name_or_path, base), Rig)
