"""Last step of planning: forces and limits along the contours, then the compensation that needs no feedback."""

from __future__ import annotations

from isf_core.contour import Contour
from isf_core.job import JobFile

from isf_planner.compensation import compensate
from isf_planner.predictions import with_predictions


def finish(contours: tuple[Contour, ...], job_file: JobFile) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
    """Contours with predicted forces and compensated tips, and warnings with their place."""
    filled, warnings = with_predictions(contours, job_file)
    moved, told = compensate(filled, job_file)
    return moved, (*warnings, *told)
