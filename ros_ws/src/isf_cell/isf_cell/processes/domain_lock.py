"""One cell at a time in a ROS domain of this computer, decided before a node starts."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError


def lock_file(domain: str) -> Path:
    """Of all users of this computer."""
    return Path(tempfile.gettempdir()) / f"isf_cell_domain_{domain}.lock"


@contextmanager
def alone_in_domain() -> Iterator[None]:
    """Until the end of the block nobody else has a cell in this ROS domain; a killed process has none any more.

    Cells on other computers, and those that were launched otherwise, are not seen here but when they answer. Raises
    IsfError BUSY.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    try:
        number = os.open(lock_file(domain), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError:  # of another user, or no place for it: what answers in the domain is still looked at
        yield
        return
    with os.fdopen(number, "r+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise busy(domain, f" (process {holder})" if (holder := file.read(20).strip()) else "") from error
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield


def busy(domain: str, who: str = "") -> IsfError:
    """Another cell is there."""
    return IsfError(
        ErrorCode.BUSY,
        f"another cell is running in ROS domain {domain}{who}",
        advice="end it, or choose another domain: ROS_DOMAIN_ID=7 ./isf form ...",
    )
