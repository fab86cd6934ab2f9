"""The newest wrench of each tool, and whether both belong to the same control tick (lockstep)."""

from __future__ import annotations

from collections.abc import Sequence

_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class WrenchPair:
    """Collects wrenches (6,) of both tools by their stamps in ns."""

    def __init__(self) -> None:
        self.wrench: list[Sequence[float]] = [_NONE, _NONE]
        """Newest wrench of tool 1 and 2."""
        self._stamp = [-1, -1]
        self._handled = -1

    def put(self, tool: int, stamp: int, wrench: Sequence[float]) -> None:
        """Keep the wrench of ``tool`` (1, 2) with ``stamp`` ns, if it is not older than the one kept."""
        if stamp >= self._stamp[tool - 1]:
            self._stamp[tool - 1] = stamp
            self.wrench[tool - 1] = wrench

    def take(self) -> int | None:
        """Stamp (ns) of a complete pair that was not taken before, else None."""
        first, second = self._stamp
        if first != second or first <= self._handled:
            return None
        self._handled = first
        return first

    def restart(self) -> None:
        """Forget everything: the machine may have started anew with earlier stamps."""
        self._stamp, self._handled = [-1, -1], -1
