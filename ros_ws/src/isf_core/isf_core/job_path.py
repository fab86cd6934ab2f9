"""The path section of a job file: how the surface is turned into contours."""

from __future__ import annotations

from pydantic import Field

from isf_core.model_base import FileModel
from isf_core.quantity import Length, Speed


class PathSpec(FileModel):
    """How the surface is turned into contours."""

    incremental_depth: Length = Field(gt=0.01e-3, lt=5e-3)
    point_spacing: Length = Field(gt=0.05e-3, lt=5e-3)
    feed: Speed = Field(gt=0.1e-3, lt=1.0)
    squeeze_factor: float = Field(default=1.0, gt=0.3, le=1.2)
    """Planned tool gap over predicted thickness; 1 = sine-law gap."""
