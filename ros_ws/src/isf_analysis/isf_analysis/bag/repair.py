"""A bag whose writer was killed, made readable again.

An MCAP file is a magic number, records (one byte of opcode, eight of length, content), an index, a footer and the
magic number again. A killed writer leaves the first two, the last record possibly cut. The readable copy ends after the
last whole record and gets a footer that says "no index"; readers then scan the records. Source: MCAP format
specification 0, sections "Records", "Footer".

A killed writer of SQLite leaves a journal beside the database: what its last transaction overwrote. SQLite itself puts
it back in the readable copy.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _DATA_END = 0x01, 0x02, 0x0F
_PREFIX = 9  # opcode and length


def whole_records(damaged: Path, repaired: Path) -> bool:
    """Copy the whole records of the MCAP file ``damaged`` to the new file ``repaired``; False when there is none."""
    with damaged.open("rb") as source:
        end = _end_of_whole_records(source)
        if end is None:
            return False
        source.seek(0)
        with repaired.open("xb") as target:
            shutil.copyfileobj(source, target)
            target.truncate(end)
            target.seek(end)
            target.write(_record(_DATA_END, bytes(4)))  # no checksum
            target.write(_record(_FOOTER, bytes(20)))  # no summary, no checksum
            target.write(MAGIC)
    return True


def in_transaction(file: Path) -> bool:
    """True for an SQLite file whose writer was ended within a transaction, or is writing."""
    return file.suffix == ".db3" and _journal(file).is_file()


def rolled_back(damaged: Path, repaired: Path) -> None:
    """Copy the SQLite file ``damaged`` as it was after its last whole transaction to the new file ``repaired``.

    Raises OSError, sqlite3.Error.
    """
    shutil.copyfile(_journal(damaged), _journal(repaired))  # first: without it the copy would look whole
    shutil.copyfile(damaged, repaired)
    with closing(sqlite3.connect(repaired)) as database:
        database.execute("SELECT count(*) FROM sqlite_master").fetchone()


def _journal(file: Path) -> Path:
    return file.with_name(f"{file.name}-journal")


def _end_of_whole_records(source: BinaryIO) -> int | None:
    """Position after the last whole data record; None when not even the header of the file is whole."""
    size = os.fstat(source.fileno()).st_size
    if source.read(len(MAGIC)) != MAGIC:
        return None
    end: int | None = None
    position = len(MAGIC)
    while position + _PREFIX <= size:
        source.seek(position)
        prefix = source.read(_PREFIX)
        opcode, length = prefix[0], int.from_bytes(prefix[1:], "little")
        following = position + _PREFIX + length
        if end is None and opcode != _HEADER:
            return None
        if opcode in (_DATA_END, _FOOTER) or following > size:
            break
        end = position = following
    return end


def _record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + len(content).to_bytes(8, "little") + content
