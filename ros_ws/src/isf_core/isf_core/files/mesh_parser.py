"""Meshes in text and packed formats, parsed by trimesh within bounds of memory.

The parsers make objects of every number: up to thirty times the size of the text, and a packed format unpacks to a
thousand times its own size.
"""

from __future__ import annotations

import errno
import io
import zipfile
from typing import Any

from isf_core.files.bounded import MEGABYTE, unpacked

LARGEST = {
    **{"stl": 100 * MEGABYTE, "obj": 40 * MEGABYTE, "ply": 40 * MEGABYTE, "off": 25 * MEGABYTE},
    **{"3mf": 16 * MEGABYTE},
}
"""bytes by format, of a packed one when it is unpacked: what is parsed in 1 GB of memory."""
LARGEST_PLY_TEXT = 12 * MEGABYTE
"""bytes of a PLY in text."""


def check_mesh_size(data: bytes, kind: str) -> None:
    """Raise OSError for a file of ``kind`` ("obj") with more than LARGEST bytes, and ValueError for a damaged zip."""
    largest = LARGEST_PLY_TEXT if kind == "ply" and b"format ascii" in data[:1000] else LARGEST[kind]
    if len(data) > largest:
        raise OSError(errno.EFBIG, f"is larger than {largest / MEGABYTE:g} MB")
    if kind != "3mf":
        return
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for _, content in unpacked(archive, largest):  # the parser unpacks without a bound
                if b"<!DOCTYPE" in content:
                    raise ValueError("names entities, which 3MF does not allow")
    except OSError:
        raise
    except Exception as error:  # zipfile and zlib raise whatever the damage makes them stumble over
        raise ValueError(f"is damaged: {error}") from error


def parse_mesh(data: bytes, kind: str, *, process: bool = True) -> Any:
    """Mesh or scene of trimesh from a file of ``kind`` ("obj", of LARGEST); ``process``: vertices are merged.

    Raises OSError for a file that is too large, ValueError for one that cannot be read.
    """
    import trimesh  # late: jobs without a mesh need not pay

    check_mesh_size(data, kind)
    try:
        return trimesh.load(io.BytesIO(data), file_type=kind, process=process)
    except Exception as error:  # the parsers raise whatever the damage makes them stumble over
        raise ValueError(f"{type(error).__name__}: {error}") from error
