"""How a hexapod is set up: height of its table, length of the mounted tool and joints (Torrao 2013, chapter 4)."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from isf_core.files.quantity import Angle, Length
from isf_core.files.yaml_file import FileModel
from isf_core.geometry.hexapod import Hexapod, spif_a


class HexapodSetUp(FileModel):
    """Of `kinematics: hexapod_spif_a`: what the plates' geometry leaves open."""

    table: Length = Field(default=1.475, gt=0.5, lt=3.0)
    """From the plane of the base's joints down to the sheet; the table's height is a set-up value."""
    gauge_line: Length = Field(default=0.338, gt=0.0, lt=1.0)
    """From the plane of the platform's joints down to the chuck."""
    stick_out: Length = Field(default=0.070, gt=1e-3, lt=1.0)
    """Of the mounted tool from the chuck to its tip, where a job's `tool_1.stick_out` does not tell."""
    joint_limit: Angle = Field(default=math.radians(45.0), gt=0.0, lt=math.radians(90.0))
    """Of the universal joints, from where they are straight."""
    joints_straight: Literal["along_legs", "along_normals"] = "along_legs"
    """Where that is: along the legs of the upright platform in mid-stroke, or along the normals of both plates."""

    def kinematics(self) -> Hexapod:
        """Of the machine that is set up so."""
        return spif_a(
            tool_length=self.gauge_line + self.stick_out,
            sheet=(0.0, 0.0, -self.table),
            joint_limit=self.joint_limit,
            along_normals=self.joints_straight == "along_normals",
        )
