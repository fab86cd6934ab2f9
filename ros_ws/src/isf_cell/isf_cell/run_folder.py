"""Where a run puts its results."""

from __future__ import annotations

import time
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError


def make_run_folder(output: Path | None, job_name: str) -> Path:
    """Create the folder of a run: ``output``, or ``runs/JOB-TIME`` under the present folder.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE when it exists with something in it or cannot be made
    """
    folder = output or _unused(Path("runs") / f"{job_name}-{time.strftime('%Y%m%d-%H%M%S')}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise IsfError(
                ErrorCode.FILE_NOT_WRITABLE, "is not empty", where=str(folder), advice="choose another --output"
            )
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(folder), advice="choose a writable --output"
        ) from error
    return folder.resolve()


def _unused(folder: Path) -> Path:
    candidate, number = folder, 1
    while candidate.exists():
        number += 1
        candidate = folder.with_name(f"{folder.name}-{number}")
    return candidate
