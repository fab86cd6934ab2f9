"""Files from outside, read as a whole: no pipe, no device, and none that is larger than what it is for.

What is packed in a file is unpacked within bounds, too: a zip of some kB may hold gigabytes.
"""

from __future__ import annotations

import errno
import json
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MEGABYTE = 1_000_000
LARGEST_TABLE = 100 * MEGABYTE
"""bytes of a table of readings: hours of six channels at 500 Hz."""
LARGEST_NOTES = 3 * MEGABYTE
"""bytes of a table that people make of some readings, 50,000 rows: read number by number."""
LARGEST_JSON = 20 * MEGABYTE
"""bytes; what it holds takes thirty times as much memory."""
LONGEST_LINE = 10_000
"""characters in a line of a table."""


def read_content(path: Path, largest: int) -> bytes:
    """What is in the file, at most ``largest`` bytes; raises OSError, also for a pipe, a device and a larger file."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):  # to open a pipe would wait for who writes to it
        raise OSError(errno.EINVAL, "is no file, but a folder, a pipe or a device", str(path))
    content = b""
    if status.st_size <= largest:
        with path.open("rb") as file:
            content = file.read(largest + 1)  # it may grow, or its size be told as none
    if max(len(content), status.st_size) > largest:
        raise OSError(errno.EFBIG, f"is larger than {largest / MEGABYTE:g} MB", str(path))
    return content


def read_text(path: Path, largest: int = LARGEST_TABLE, errors: str = "strict") -> str:
    """Text of the file in UTF-8, line ends as of :meth:`Path.read_text`; ``errors`` as of :meth:`bytes.decode`.

    The byte order mark that spreadsheets begin a file with is no part of it.

    Raises OSError as :func:`read_content`, and for what is no such text.
    """
    try:
        text = read_content(path, largest).decode("utf-8", errors)
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"is no text in UTF-8: {error}", str(path)) from error
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")


def read_lines(path: Path, largest: int = LARGEST_NOTES) -> list[str]:
    """Lines of a table; raises OSError as :func:`read_text`, and for one with a line longer than LONGEST_LINE."""
    lines = read_text(path, largest).splitlines()
    for number, line in enumerate(lines, start=1):
        if len(line) > LONGEST_LINE:
            raise OSError(errno.EILSEQ, f"line {number} has more than {LONGEST_LINE:,} characters", str(path))
    return lines


def reason(error: Exception) -> str:
    """What a person is told of ``error``: of the operating system's the words alone, without number and path."""
    return error.strerror or "unknown" if isinstance(error, OSError) else f"{error}"


def parse_json(text: str | bytes) -> Any:
    """What the JSON ``text`` holds; raises ValueError where it is none, or nested too deeply."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("is nested too deeply") from error


def read_json(path: Path, largest: int = LARGEST_JSON) -> Any:
    """What the JSON file holds; raises OSError as :func:`read_text`, and for what is no JSON."""
    try:
        return parse_json(read_text(path, largest))
    except ValueError as error:
        raise OSError(errno.EILSEQ, f"is no JSON: {error}", str(path)) from error


MOST_MEMBERS = 10_000
"""Files in a zip: of any archive that is read here there are some dozens."""


def unpacked(archive: zipfile.ZipFile, largest: int) -> Iterator[tuple[str, bytes]]:
    """Name and content of every file in the ``archive``, at most ``largest`` bytes of all together.

    The table of the archive is asked before anything is unpacked, and no file is unpacked beyond what it says there.
    Raises OSError for what is larger, and whatever zipfile raises for a damaged one.
    """
    members = archive.infolist()
    if len(members) > MOST_MEMBERS or sum(member.file_size for member in members) > largest:
        raise OSError(errno.EFBIG, f"is larger than {largest / MEGABYTE:g} MB when it is unpacked")
    for member in members:
        with archive.open(member) as file:
            yield member.filename, file.read(member.file_size + 1)
