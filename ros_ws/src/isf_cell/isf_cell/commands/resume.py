"""``isf form --resume RUN``: what the run was begun with, whether it can go on, and what is said of it."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_json, reason
from isf_core.files.job import load_job

from isf_cell.run.checkpoint import CHECKPOINT, Checkpoint, CheckpointFolder

REQUEST_FILE = "request.json"
"""In the folder of the checkpoint: what the command was asked for beyond what the executive knows."""

LOCK_FILE = "lock"
"""Beside it, held by the command that forms the part."""


@dataclass(frozen=True)
class Request:
    """``job``: file; ``attach``: to be formed in a cell that is up."""

    job: Path
    attach: bool = False

    def write(self, run: Path) -> None:
        """Keep it with the run; raises IsfError FILE_NOT_WRITABLE."""
        path = run / CHECKPOINT / REQUEST_FILE
        try:
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps({"job": str(self.job.absolute()), "attach": self.attach}), encoding="utf-8")
        except OSError as error:
            raise IsfError(ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(path)) from error

    @classmethod
    def read(cls, run: Path) -> Request:
        """Raises IsfError FILE_NOT_FOUND, CHECKPOINT_UNUSABLE."""
        path = run / CHECKPOINT / REQUEST_FILE
        try:
            data = read_json(path)
            return cls(Path(data["job"]), bool(data["attach"]))
        except FileNotFoundError as error:
            raise IsfError(
                ErrorCode.FILE_NOT_FOUND,
                "not a run of ./isf form that can go on: it has no checkpoint",
                where=str(run),
                advice="name the folder that ./isf form wrote to; ./isf simulate keeps none",
            ) from error
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise IsfError(
                ErrorCode.CHECKPOINT_UNUSABLE,
                f"is damaged: {reason(error)}",
                where=str(path),
                advice="form the part again",
            ) from error


@dataclass(frozen=True)
class Resumed:
    """A part that goes on. ``job`` : its file, None where that is gone or holds another job by now."""

    checkpoint: Checkpoint
    job: Path | None


def resumed(run: Path, given: Mapping[str, Any]) -> Resumed:
    """The part of ``run``; ``given``: options of the command line by their names, with what they ask for.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, CHECKPOINT_UNUSABLE, PART_FINISHED, SHEET_TORN (cannot go on); FILE_FIELD (an option
        asks for something else than what the part was begun with); of the job
    """
    request = Request.read(run)
    checkpoint = CheckpointFolder(run / CHECKPOINT).read()
    begun = {
        "JOB": checkpoint.job_text,
        "--correction": checkpoint.correction,
        "--support-force": checkpoint.support_force,
        "--variant": checkpoint.variant,
        "--seed": checkpoint.seed,
        "--sheet": checkpoint.sheet,
        "--output": run.resolve(),
        "--real-time": not checkpoint.lockstep,
    }
    for name, value in given.items():
        asked = load_job(value).text if name == "JOB" else Path(value).resolve() if name == "--output" else value
        if asked != begun[name]:
            words = "another job" if name == "JOB" else f"{asked}, the part was begun with {begun[name]}"
            raise IsfError(
                ErrorCode.FILE_FIELD, words, where=name, advice="leave it out: a part goes on as it was begun"
            )
    try:
        same = load_job(request.job).text == checkpoint.job_text
    except IsfError:
        same = False
    return Resumed(checkpoint, request.job if same else None)


def how_to_go_on(run: Path) -> str:
    """The command with which the part of ``run`` goes on; empty: it cannot."""
    try:
        CheckpointFolder(run / CHECKPOINT).read()
        attach = Request.read(run).attach
    except IsfError:
        return ""
    where, option = (", in a cell that is up", " --attach") if attach else ("", "")
    return f"the part can go on{where}: ./isf form --resume {run}{option}"


def being_formed(run: Path) -> bool:
    """True while another command forms the part of ``run``."""
    try:
        with (run / CHECKPOINT / LOCK_FILE).open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # no such run, or no locks here
        return False
    return False


def with_advice(error: IsfError, run: Path) -> IsfError:
    """``error``, its advice followed by the command with which the part of ``run`` goes on, if it can."""
    advice = "; ".join(filter(None, (error.advice, how_to_go_on(run))))
    return IsfError(error.code, error.what, where=error.where, advice=advice)


@contextmanager
def alone(run: Path) -> Iterator[None]:
    """Only one command at a time forms the part of ``run``; a killed one does not count.

    Where nothing came of it, nothing is left there, so that the same command can be given again. Raises IsfError BUSY,
    FILE_NOT_WRITABLE.
    """
    path = run / CHECKPOINT / LOCK_FILE
    try:
        path.parent.mkdir(exist_ok=True)
        file = path.open("w")
    except OSError as error:
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(path)) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise IsfError(
                ErrorCode.BUSY,
                "another command forms this part",
                where=str(run),
                advice="wait until it ends, or end it",
            ) from error
        except OSError as error:  # a file system without locks
            raise IsfError(ErrorCode.FILE_NOT_WRITABLE, f"cannot be locked: {error}", where=str(path)) from error
        try:
            yield
        finally:
            _clear_unless_begun(run)


def _clear_unless_begun(run: Path) -> None:
    """Remove what is written before a part begins, where there is nothing else."""
    kept = run / CHECKPOINT
    with suppress(OSError):
        if list(run.iterdir()) == [kept] and {file.name for file in kept.iterdir()} <= {LOCK_FILE, REQUEST_FILE}:
            for file in kept.iterdir():
                file.unlink()
            kept.rmdir()
