"""A file that is replaced in one step: who reads it has a whole one, the old or the new."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from isf_core.errors import ErrorCode, IsfError


@contextmanager
def replacing(path: Path, *, make_folder: bool = False, advice: str = "choose another folder") -> Iterator[IO[bytes]]:
    """What is written to the stream takes the place of the file ``path``, on the disk when the context ends.

    ``make_folder``: its folder need not be there. Raises IsfError FILE_NOT_WRITABLE, with ``advice``.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")  # another process may write the same file
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)  # a link of that name is not followed
        with partial.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, f"cannot be written: {error}", where=str(path), advice=advice
        ) from error
