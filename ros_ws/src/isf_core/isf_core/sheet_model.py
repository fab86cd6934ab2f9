"""The models that form a simulated sheet."""

from __future__ import annotations

from typing import Literal, get_args

from isf_core.errors import ErrorCode, IsfError

SheetModel = Literal["fast", "shell"]
"""``fast``: reduced model, seconds per part; ``shell``: elasto-plastic shell elements, minutes per part."""

SHEET_MODELS: tuple[SheetModel, ...] = get_args(SheetModel)

DEFAULT_SHEET: SheetModel = "fast"


def sheet_model(name: str, where: str = "sheet") -> SheetModel:
    """The model called ``name``, the default one for an empty name.

    Raises
    ------
    IsfError : FILE_FIELD, there is none
    """
    if name and name not in SHEET_MODELS:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"there is no model '{name}' of the sheet",
            where=where,
            advice=f"known: {', '.join(SHEET_MODELS)}",
        )
    return name or DEFAULT_SHEET
