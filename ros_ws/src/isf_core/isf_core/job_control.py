"""The control section of a job file: force and compliance control."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from isf_core.force_rule import ForceRule
from isf_core.model_base import FileModel
from isf_core.quantity import Angle, Force, Frequency, Length

LARGEST_SUPPORT_FORCE = 1500.0
"""N, that a job or a run may ask for."""
SupportForce = Annotated[Force, Field(ge=0.0, le=LARGEST_SUPPORT_FORCE)]


class ControlSpec(FileModel):
    """Force and compliance control."""

    rate: Frequency = Field(default=500.0, ge=100.0, le=2000.0)
    """Rate f_s of wrenches and targets."""
    support_force: Literal["auto"] | SupportForce = 0.0
    """Set-point of the horizontal normal force on the support tool; 0 = position control, ``auto`` = from sheet, tools,
    rig and wall angle (:mod:`isf_core.support_window`)."""
    force_rules: tuple[ForceRule, ...] = ()
    """Other set-points on some walls, corners, depths or places (:mod:`isf_core.force_rule`); the last rule that holds
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
