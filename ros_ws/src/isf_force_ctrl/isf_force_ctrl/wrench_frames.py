"""The frame that wrenches come in: forces in other axes would be pushed against in the wrong direction."""

from __future__ import annotations

from collections.abc import Sequence

from isf_core.errors import ErrorCode, IsfError


class WrenchFrames:
    """Frames of the newest wrenches of both tools; ``frame`` is the one that is right."""

    def __init__(self, frame: str) -> None:
        self._frame = frame
        self._seen = [frame, frame]

    def right(self, tool: int, frame: str) -> bool:
        """Take note of the ``frame`` of a wrench of ``tool`` (1, 2)."""
        self._seen[tool - 1] = frame
        return frame == self._frame

    def text(self, tool: int) -> str:
        """What is wrong with the wrenches of ``tool``."""
        return (
            f"tool_{tool}/wrench comes in frame '{self._seen[tool - 1]}', not '{self._frame}' (rotate it into axes of "
            "the sheet, or set the parameter wrench_frame where only the name differs)"
        )

    def check(self, tools: Sequence[int]) -> None:
        """Raise IsfError WRENCH_FRAME when the newest wrench of one of ``tools`` came in another frame."""
        for tool in tools:
            if self._seen[tool - 1] != self._frame:
                raise IsfError(ErrorCode.WRENCH_FRAME, self.text(tool))
