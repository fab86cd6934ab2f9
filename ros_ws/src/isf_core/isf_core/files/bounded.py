"""Files from outside, read as a whole: no pipe, no device, and none that is larger than what it is for."""

from __future__ import annotations

import errno
import stat
from pathlib import Path

MEGABYTE = 1_000_000
LARGEST_TABLE = 100 * MEGABYTE
"""bytes of a table of readings: hours of six channels at 500 Hz."""


def read_content(path: Path, largest: int) -> bytes:
    """What is in the file, at most ``largest`` bytes; raises OSError, also for a pipe, a device and a larger file."""
    if not stat.S_ISREG(path.stat().st_mode):  # to open a pipe would wait for who writes to it
        raise OSError(errno.EINVAL, "is no file, but a folder, a pipe or a device", str(path))
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"is larger than {largest / MEGABYTE:g} MB", str(path))
    return content


def read_text(path: Path, largest: int = LARGEST_TABLE, errors: str = "strict") -> str:
    """Text of the file in UTF-8, line ends as of :meth:`Path.read_text`; ``errors`` as of :meth:`bytes.decode`.

    Raises OSError as :func:`read_content`, and for what is no such text.
    """
    try:
        text = read_content(path, largest).decode("utf-8", errors)
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"is no text in UTF-8: {error}", str(path)) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")
