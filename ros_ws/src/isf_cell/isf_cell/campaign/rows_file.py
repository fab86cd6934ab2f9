"""Rows of a campaign as JSON lines: a line is there whole or not at all, whatever ends the campaign."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import parse_json, read_text


def read_rows(path: Path) -> dict[str, dict[str, Any]]:
    """Rows by their ``key``, the last of each; a line that was cut off by a stop is left out.

    Raises
    ------
    IsfError : FILE_SYNTAX when the file cannot be read as text
    """
    rows: dict[str, dict[str, Any]] = {}
    if not path.exists():
        return rows
    try:
        lines = read_text(path).splitlines()
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"cannot be read: {error.strerror}",
            where=str(path),
            advice="choose another --output",
        ) from error
    for text in lines:
        try:
            row = parse_json(text)
        except ValueError:
            continue
        if isinstance(row, dict) and isinstance(row.get("key"), str):
            rows[row["key"]] = row
    return rows


def append_row(path: Path, row: Mapping[str, Any]) -> None:
    """Append a row by one write; a line that a stop cut off is closed first.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab+", buffering=0) as file:
            end = file.seek(0, 2)
            file.seek(max(end - 1, 0))
            cut = end > 0 and file.read(1) != b"\n"
            file.write((("\n" if cut else "") + json.dumps(row) + "\n").encode())
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(path), advice="make room, then the same command goes on"
        ) from error


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Inside, no other campaign adds to ``path``; raises IsfError BUSY when one does, FILE_NOT_WRITABLE."""
    try:
        file = path.open("ab")
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(path), advice="choose another --output"
        ) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise IsfError(
                ErrorCode.BUSY,
                "another campaign is running in this folder",
                where=str(path.parent),
                advice="wait for its end, or choose another --output",
            ) from error
        yield
