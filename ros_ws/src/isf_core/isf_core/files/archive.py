"""Arrays in a numpy archive that is replaced in one step: a file that is there is a whole one."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from isf_core.errors import ErrorCode, IsfError


def write_archive(
    path: Path, arrays: Mapping[str, Any], *, compressed: bool = False, make_folder: bool = False
) -> None:
    """Replace the file ``path``; it is on the disk when this returns. ``make_folder``: its folder need not be there.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE
    """
    partial = path.with_name(path.name + ".partial")
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)  # a link of that name is not followed
        with partial.open("wb") as file:
            (np.savez_compressed if compressed else np.savez)(file, **arrays)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, f"cannot be written: {error}", where=str(path), advice="choose another folder"
        ) from error
