"""The springback section of a job file: how each contour is corrected before it is formed."""

from __future__ import annotations

from pydantic import Field

from isf_core.model_base import FileModel


class SpringbackSpec(FileModel):
    """Correction of each contour before it is formed."""

    method: str = "none"
    """Name of a method of isf_springback ("none", "analytic", ...)."""
    gain: float = Field(default=1.0, ge=0.0, le=2.0)
