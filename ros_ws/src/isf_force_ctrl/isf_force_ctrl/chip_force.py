"""The support force from which the sheet sheds chips."""

from __future__ import annotations

from isf_core.job import JobFile

CHIP_FACTOR = 0.42
"""Calibrated: F = c R_m R t0 lies between the 120 N that leave AA1100-O of 1 mm fine under tools of 4.5 mm, and the
200 N that shed chips (Ren 2018, 2.4.1), at their geometric mean."""


def chip_force(tensile_strength: float, radius: float, thickness: float) -> float:
    """N, normal force from which chips are to be expected; Pa, m of the smaller tool, m of the blank."""
    return CHIP_FACTOR * tensile_strength * radius * thickness


def chip_warning(job_file: JobFile, support_force: float | None) -> str:
    """What to say about ``support_force`` N (None: the job's) on the job's sheet; empty when it leaves it fine."""
    job = job_file.job
    force = job.control.support_force if support_force is None else support_force
    if job.tool_2 is None or force <= 0.0:
        return ""
    radius = min(job.tool_1.radius, job.tool_2.radius)
    most = chip_force(job_file.material.tensile_strength, radius, job.sheet.thickness)
    if force <= most:
        return ""
    return (
        f"support force of {force:.0f} N: {job_file.material.name} of {1e3 * job.sheet.thickness:g} mm may shed chips "
        f"under tools of {1e3 * radius:g} mm from {most:.0f} N on"
    )
