"""A six-axis arm as a rig file tells of it: links, limits, stiffness, where it stands, and the tool it holds."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

from pydantic import Field, model_validator

from isf_core.files.quantity import Angle, AngularSpeed, AngularStiffness, Frequency, Length
from isf_core.files.yaml_file import FieldError, FileModel
from isf_core.geometry.serial_arm import ArmJoint, SerialArm, choose_posture

_AXES = {"x": 0, "y": 1, "z": 2}
_ORDER = ("z", "y", "y", "x", "y", "x")
"""Along which axis of the base each joint turns, all of them at zero."""


class Joint(FileModel):
    """One joint, with all joints at zero."""

    name: str
    """Of the joint, as the controller calls it."""
    place: tuple[Length, Length, Length]
    """Of the joint in the link before; of the first, in the base."""
    axis: Literal["x", "-x", "y", "-y", "z", "-z"]
    """About which it turns."""
    range: tuple[Angle, Angle]
    """Smallest and largest position."""
    speed: AngularSpeed = Field(gt=0)
    """Largest."""
    stiffness: AngularStiffness = Field(gt=0)
    """Torque per turn of drive and gear, as the tool feels it."""
    radius: Length = Field(default=0.15, gt=0)
    """Of the link from this joint to the next, taken as a capsule (assumed where it is left out)."""

    @model_validator(mode="after")
    def _rising(self) -> Joint:
        if not self.range[0] < self.range[1]:
            raise ValueError("range must rise")
        return self


class Arm(FileModel):
    """An arm whose joints turn about z, y, y, x, y, x while they are at zero, the last three through one point."""

    model: str
    """Name of the arm."""
    joints: tuple[Joint, Joint, Joint, Joint, Joint, Joint]
    """From the base to the flange."""
    flange: Length = Field(default=0.0, ge=0)
    """From the place of the last joint to the flange, along its axis."""
    tool: Length = Field(gt=0)
    """From the flange to the tip."""
    tool_angle: Angle = Field(default=0.0, gt=-math.pi / 2, lt=math.pi / 2)
    """Between the axis of the last joint and the tool, which leans towards -z of the last link."""
    holder: Length = Field(default=0.05, gt=0)
    """Radius of what holds the tool between flange and shank."""
    base: tuple[Length, Length, Length]
    """Of the base in frame sheet."""
    base_turn: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Of the base against frame sheet, about its fixed axes x, y, z in this order."""
    table: Length | None = Field(default=None, gt=0)
    """Of the top of the table below the sheet, which no link may touch; without it there is none."""
    roll: Angle | None = None
    """Turn of the tool about its own axis, held while forming; without it the one farthest from limits and singular
    poses over the travel."""
    tilt_limit: Angle = Field(default=math.radians(30.0), ge=0, le=math.radians(60.0))
    """Largest tilt of the tool."""
    singular_clearance: Angle = Field(default=math.radians(5.0), gt=0)
    """Least angle of shoulder, elbow and wrist from a singular pose."""
    natural_frequency: Frequency = Field(default=10.0, gt=0.5)
    """Lowest of the arm with its tool: how fast the simulated arm gives way."""

    @model_validator(mode="after")
    def _spherical_wrist(self) -> Arm:
        for number, (joint, wanted) in enumerate(zip(self.joints, _ORDER, strict=True)):
            if joint.axis.lstrip("-") != wanted:
                raise FieldError(
                    f"joint {joint.name} turns about {joint.axis}, the joints of an arm turn about "
                    "z, y, y, x, y, x while they are at zero",
                    field=f"joints.{number}.axis",
                    advice="describe the arm with its zero pose stretched along x; another kind of arm cannot be had",
                )
        places = [joint.place for joint in self.joints]
        off = (
            [("0.place", places[0][:2])]
            + [(f"{k}.place", (places[k][1],)) for k in (1, 2, 3)]
            + [("4.place", places[4][1:]), ("5.place", places[5][1:])]
        )
        for field, values in off:
            if any(abs(value) > 1e-9 for value in values):
                raise FieldError(
                    "the joint stands beside the plane of the arm, or the last three axes do not meet",
                    field=f"joints.{field}",
                    advice="joint 1 lies on z of the base, 2 to 4 have y = 0, 5 and 6 only x",
                )
        return self

    def kinematics(self, region: tuple[float, float, float], *, side: int = 1) -> SerialArm:
        """The arm above (``side`` 1) or below (-1) the sheet, with the roll and branch of :func:`choose_posture` for
        tips with coordinates up to ``region`` (3,) m."""
        return _made(self, tuple(region), side)


@lru_cache(maxsize=32)  # several parts of a cell ask for it, some of them at every contour
def _made(arm: Arm, region: tuple[float, float, float], side: int) -> SerialArm:
    joints = tuple(
        ArmJoint(
            joint.name,
            joint.place,
            _AXES[joint.axis[-1]],
            -1 if joint.axis.startswith("-") else 1,
            joint.range[0],
            joint.range[1],
            joint.speed,
            joint.stiffness,
        )
        for joint in arm.joints
    )
    made = SerialArm(
        joints=joints,
        flange=arm.flange,
        tool=arm.tool,
        place=arm.base,
        turn=arm.base_turn,
        tool_angle=arm.tool_angle,
        tilt_limit=arm.tilt_limit,
        clearance=arm.singular_clearance,
        side=side,
        name=arm.model,
    )
    return choose_posture(made, region, arm.roll)
