"""Binary STL files, told from text ones by their length and not by their first word."""

from __future__ import annotations

import struct

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

Array = NDArray[np.float64]

_HEADER, _FACET = 84, 50

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_binary(data: bytes, where: str) -> Array | None:
    """(F, 3, 3) corners of a binary file in its unit; None for a text file.

    Many programs begin binary files with "solid" too: a file is binary when its length is what its count promises,
    or when its first part holds bytes that no text has.

    Raises
    ------
    IsfError : MESH_UNREADABLE for a binary file that ends early
    """
    if len(data) < _HEADER:
        return None
    (count,) = struct.unpack("<I", data[80:_HEADER])
    present = (len(data) - _HEADER) // _FACET
    if count != present or len(data) != _HEADER + _FACET * count:
        if _is_text(data[:1024]):
            return None
        if count > present:
            raise IsfError(
                ErrorCode.MESH_UNREADABLE,
                f"the file ends early: {present} of {count} facets",
                where=where,
                advice="copy or export the file again",
            )
    records = np.frombuffer(data, dtype=_RECORD, count=min(count, present), offset=_HEADER)
    return records["corners"].astype(np.float64)


def _is_text(beginning: bytes) -> bool:
    """No control characters but those of text."""
    return all(byte >= 32 or byte in (9, 10, 12, 13) for byte in beginning) and b"\x7f" not in beginning
