"""The models that form a simulated sheet."""

from __future__ import annotations

from typing import Literal, get_args

SheetModel = Literal["fast", "shell"]
"""``fast``: reduced model, seconds per part; ``shell``: elasto-plastic shell elements, minutes per part."""

SHEET_MODELS: tuple[SheetModel, ...] = get_args(SheetModel)
