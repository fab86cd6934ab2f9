"""When the shape is scanned between contours."""

from __future__ import annotations

from isf_core.files.job import JobFile


def scan_due(job_file: JobFile, index: int, count: int) -> bool:
    """True when the shape is measured between contour ``index`` (0-based) and the next one of ``count``."""
    every = job_file.job.springback.scan_every
    return every > 0 and (index + 1) % every == 0 and index + 1 < count


def scan_awaited(job_file: JobFile, index: int) -> bool:
    """True when contour ``index`` is corrected from a scan made just before it."""
    return index > 0 and scan_due(job_file, index - 1, index + 1)
