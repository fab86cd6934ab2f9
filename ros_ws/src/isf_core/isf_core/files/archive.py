"""Arrays in a numpy archive that is replaced in one step: a file that is there is a whole one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from isf_core.files.whole_file import replacing


def write_archive(
    path: Path, arrays: Mapping[str, Any], *, compressed: bool = False, make_folder: bool = False
) -> None:
    """Replace the file ``path``; it is on the disk when this returns. ``make_folder``: its folder need not be there.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE
    """
    with replacing(path, make_folder=make_folder) as file:
        (np.savez_compressed if compressed else np.savez)(file, **arrays)
