"""The newest wrench of each tool, and whether both belong to the same control tick."""

from __future__ import annotations

from collections.abc import Sequence

_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class WrenchPair:
    """Collects wrenches (6,) of both tools by their stamps in ns."""

    def __init__(self) -> None:
        self.wrench: list[Sequence[float]] = [_NONE, _NONE]
        """Newest wrench of tool 1 and 2."""
        self._stamp = [-1, -1]
        self._fresh = [False, False]
        self._handled = -1

    def put(self, tool: int, stamp: int, wrench: Sequence[float]) -> None:
        """Keep the wrench of ``tool`` (1, 2) with ``stamp`` ns, if it is not older than the one kept."""
        if stamp >= self._stamp[tool - 1]:
            self._fresh[tool - 1] |= stamp > self._stamp[tool - 1]
            self._stamp[tool - 1] = stamp
            self.wrench[tool - 1] = wrench

    def take(self) -> int | None:
        """Stamp (ns) of a complete pair that was not taken before, else None (lockstep)."""
        first, second = self._stamp
        if first != second or first <= self._handled:
            return None
        self._handled = first
        return first

    def fresh(self, tools: Sequence[int]) -> bool:
        """True when each of ``tools`` has a newer wrench than at the last :meth:`use` (real time)."""
        return all(self._fresh[tool - 1] for tool in tools)

    def use(self) -> None:
        """The newest wrenches are used, whatever their stamps."""
        self._fresh = [False, False]

    def restart(self) -> None:
        """Forget everything: the machine may have started anew with earlier stamps."""
        self._stamp, self._handled, self._fresh = [-1, -1], -1, [False, False]
