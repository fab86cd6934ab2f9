"""A failure that has been told already, so that the end of the program does not tell it twice."""

from __future__ import annotations

from isf_core.errors import IsfError


class ReportedError(IsfError):
    """The same failure; it is part of the JSON object that was printed."""

    def __init__(self, error: IsfError) -> None:
        super().__init__(error.code, error.what, where=error.where, advice=error.advice)
