"""Settings that change in the middle of a part, before one of its contours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from isf_core.files.job import JobFile


@dataclass(frozen=True)
class PartChange:
    """Other settings from a contour on.

    Attributes
    ----------
    first_index : contour, from 0, that is the first with them
    control : parameters of force control (ControlConfig) by name, that it can be retuned to
    correction : springback method, and the job that it takes its parameters from; None: as before
    """

    first_index: int
    control: Mapping[str, object] = field(default_factory=dict)
    correction: tuple[str, JobFile] | None = None
