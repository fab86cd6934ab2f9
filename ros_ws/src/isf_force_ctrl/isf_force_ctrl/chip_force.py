"""Warning of a support force from which the sheet sheds chips; the limit: :mod:`isf_core.support_window`."""

from __future__ import annotations

from isf_core.job import JobFile
from isf_core.support_window import chip_force


def chip_warning(job_file: JobFile, support_force: float | None) -> str:
    """What to say about ``support_force`` N (None: the job's) on the job's sheet; empty when it leaves it fine."""
    job = job_file.job
    force = job.support_force_at() if support_force is None else support_force
    if job.tool_2 is None or force <= 0.0:
        return ""
    radius = min(job.tool_1.ball_radius, job.tool_2.ball_radius)
    most = chip_force(job_file.material.tensile_strength, radius, job.sheet.thickness)
    if force <= most:
        return ""
    return (
        f"support force of {force:.0f} N: {job_file.material.name} of {1e3 * job.sheet.thickness:g} mm may shed chips "
        f"under tools of {1e3 * radius:g} mm from {most:.0f} N on"
    )
