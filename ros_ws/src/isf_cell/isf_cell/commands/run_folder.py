"""Where a run puts its results."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError

TRYOUT, TRYOUT_JOB = "tryout.json", "job.yaml"
"""In the folder of a try-out: what it was begun for, and its result, the job with the correction that it found."""


@contextmanager
def run_folder(output: Path | None, job_name: str) -> Iterator[Path]:
    """The folder of :func:`make_run_folder`, removed at the end when it is new and nothing came of the run."""
    existed = output is not None and output.exists()
    folder = make_run_folder(output, job_name)
    try:
        yield folder
    finally:
        if not existed:
            with suppress(OSError):  # holds something
                folder.rmdir()


def make_run_folder(output: Path | None, job_name: str) -> Path:
    """Create the folder of a run: ``output``, or ``runs/JOB-TIME`` under the present folder.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE when it exists with something in it or cannot be made
    """
    folder = output or _unused(Path("runs") / f"{job_name}-{time.strftime('%Y%m%d-%H%M%S')}")
    made = make_folder(folder)
    if any(made.iterdir()):
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, "is not empty", where=str(folder), advice="choose another --output")
    return made


def make_folder(folder: Path) -> Path:
    """``folder``, absolute, created when missing; raises IsfError FILE_NOT_WRITABLE when files cannot be put there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):  # permissions alone do not tell it
            pass
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(folder), advice="choose a writable --output"
        ) from error
    return folder.resolve()


@contextmanager
def output_folder(folder: Path) -> Iterator[Path]:
    """The folder of :func:`make_folder`; what is new of it is removed when an error leaves it empty."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        yield make_folder(folder)
    except Exception:
        with suppress(OSError):  # holds something
            for path in new:
                path.rmdir()
        raise


def _unused(folder: Path) -> Path:
    candidate, number = folder, 1
    while candidate.exists():
        number += 1
        candidate = folder.with_name(f"{folder.name}-{number}")
    return candidate
