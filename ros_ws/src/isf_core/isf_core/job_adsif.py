"""The adsif section of a job file: accumulative double-sided forming."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from isf_core.model_base import FileModel
from isf_core.quantity import Angle, Length


class AdsifSpec(FileModel):
    """How position angle and gap of the tools are chosen (Ren 2018, chapter 3)."""

    surface: str = "AA5754-O_1mm_R5"
    """Response surface: a name in ``share/isf_core/adsif`` or a path relative to the job file."""
    pitch: Length = Field(default=0.2e-3, gt=0.01e-3, lt=2e-3)
    """Horizontal distance between two turns of the spiral."""
    projection_distance: Length | None = Field(default=None, gt=0.1e-3, lt=10e-3)
    """Depth of the forming tip below the blank's upper face, constant; None: that of the surface."""
    policy: Literal["variation", "force", "trade_off", "continuity"] = "trade_off"
    largest_variation: Angle = Field(default=math.radians(5.0), gt=0.0, lt=1.0)
    """Policy trade_off: largest angle variation at which the smallest force is looked for."""
    compensate_compliance: bool = True
    """Command the gap smaller by what the rig's tools give way under the predicted force (Ren 2018 eq. 3-12)."""
