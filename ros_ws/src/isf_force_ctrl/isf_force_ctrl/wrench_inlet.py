"""Takes wrenches in: their frame, the order and age of their stamps, and the pair that a tick uses."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from isf_core.errors import ErrorCode

from isf_force_ctrl.stamp_watch import StampWatch
from isf_force_ctrl.wrench_frames import WrenchFrames
from isf_force_ctrl.wrench_pair import WrenchPair

Fault = tuple[ErrorCode, str]


class WrenchInlet:
    """``frame`` is the one that wrenches must come in; ``most_delay`` (lockstep: inf) and ``late_for`` s as for
    :class:`StampWatch`."""

    def __init__(self, frame: str, most_delay: float, late_for: float) -> None:
        self.frames = WrenchFrames(frame)
        self.pair = WrenchPair()
        self._watches = tuple(StampWatch(tool, most_delay, late_for) for tool in (1, 2))
        self._by_clock = math.isfinite(most_delay)

    def restart(self) -> None:
        """Forget everything: the machine may have started anew with earlier stamps."""
        self.pair.restart()
        for watch in self._watches:
            watch.restart()

    def put(self, tool: int, frame: str, stamp: int, wrench: Sequence[float]) -> tuple[bool, Fault | None]:
        """Take the wrench (6,) of ``tool`` (1, 2) with ``stamp`` ns.

        Returns whether it is a sign of life (an old one is none) and code and text of what is wrong with it. By the
        clock, a driver that leaves its stamps at zero is taken at its word: now.
        """
        if not self.frames.right(tool, frame):
            return True, (ErrorCode.WRENCH_FRAME, self.frames.text(tool))
        now = time.monotonic()
        if stamp == 0 and self._by_clock:
            stamp = int(now * 1e9)
        else:
            use, fault = self._watches[tool - 1].look(stamp, now)
            if not use:
                return fault is not None, fault
            if fault:
                return True, fault
        self.pair.put(tool, stamp, wrench)
        return True, None

    def values(self) -> dict[str, object]:
        """For ``/diagnostics``: messages since the node was configured."""
        return {
            "old_wrenches": sum(watch.old for watch in self._watches),
            "late_wrenches": sum(watch.late for watch in self._watches),
        }
