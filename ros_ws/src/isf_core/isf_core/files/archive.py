"""Arrays in a numpy archive: replaced in one step, so that a file that is there is a whole one; read within bounds.

An archive from outside may be anything: it is unpacked only after its own table says that there is room for it, and
holds plain arrays, nothing that Python would have to make objects of.
"""

from __future__ import annotations

import errno
import io
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isf_core.files.bounded import MEGABYTE, read_content, unpacked
from isf_core.files.whole_file import replacing

LARGEST = 300 * MEGABYTE
"""bytes of all arrays: a million points of a plan with everything that belongs to them."""


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


def read_archive(path: Path, largest: int = LARGEST) -> dict[str, NDArray[Any]]:
    """The arrays of the file by name, at most ``largest`` bytes, unpacked.

    Raises
    ------
    OSError : as :func:`isf_core.files.bounded.read_content`; a file that is no such archive, is damaged, holds anything
        but plain arrays, or more than ``largest`` bytes of them; FileNotFoundError where there is none
    """
    content = read_content(path, largest)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return {name.removesuffix(".npy"): _array(data) for name, data in unpacked(archive, largest)}
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    except Exception as error:  # zipfile, zlib and numpy raise whatever the damage makes them stumble over
        raise OSError(errno.EILSEQ, f"is no archive of arrays, or is damaged: {error}", str(path)) from error


def _array(data: bytes) -> NDArray[Any]:
    """The array of a .npy file; its header is held against its length before numpy makes room for what it promises."""
    stream = io.BytesIO(data)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[np.lib.format.read_magic(stream)]
    shape, _, dtype = read_header(stream)
    if dtype.hasobject or dtype.itemsize == 0:
        raise ValueError(f"an array of {dtype} holds no plain values")
    if math.prod(shape) * dtype.itemsize != len(data) - stream.tell():
        raise ValueError(f"an array of {shape} is of another size than its header says")
    stream.seek(0)
    array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    return array
