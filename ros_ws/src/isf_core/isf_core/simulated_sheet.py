"""The kinds of simulated sheet that a user can choose."""

from __future__ import annotations

from typing import Literal, get_args

from isf_core.errors import ErrorCode, IsfError

SheetKind = Literal["fast", "shell", "shell_coarse", "shell_fine"]
"""``fast``: reduced model, seconds per part; ``shell``: elasto-plastic shell elements, minutes per part;
``shell_coarse`` and ``shell_fine``: the same with larger or smaller elements, and the tools quicker or slower."""

SHEET_KINDS: tuple[SheetKind, ...] = get_args(SheetKind)

DEFAULT_SHEET: SheetKind = "fast"


def sheet_kind(name: str, where: str = "sheet") -> SheetKind:
    """The kind called ``name``, the default one for an empty name.

    Raises
    ------
    IsfError : FILE_FIELD, there is none
    """
    if name and name not in SHEET_KINDS:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"there is no simulated sheet '{name}'",
            where=where,
            advice=f"known: {', '.join(SHEET_KINDS)}",
        )
    return name or DEFAULT_SHEET
