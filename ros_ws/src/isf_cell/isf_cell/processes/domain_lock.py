"""One cell at a time in a ROS domain of this computer, decided before a node starts."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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
        number = _opened(lock_file(domain))
    except OSError:  # no place for it: what answers in the domain is still looked at
        yield
        return
    try:
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(number, 20).decode(errors="replace").strip()
            raise busy(domain, f" (process {holder})" if holder else "") from error
        with suppress(OSError):  # the file of another user
            os.ftruncate(number, 0)
            os.write(number, str(os.getpid()).encode())
        yield
    finally:
        os.close(number)


def _opened(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except PermissionError:  # made by another user: it can be locked all the same
        return os.open(path, os.O_RDONLY | os.O_NOFOLLOW)


def busy(domain: str, who: str = "") -> IsfError:
    """Another cell is there."""
    return IsfError(
        ErrorCode.BUSY,
        f"another cell is running in ROS domain {domain}{who}",
        advice="form in it (isf form --attach, where isf cell started it), end it, or choose another domain: "
        "ROS_DOMAIN_ID=7 ./isf form ...",
    )
