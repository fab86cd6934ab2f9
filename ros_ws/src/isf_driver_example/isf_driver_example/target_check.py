"""What a driver asks of targets before it follows them: a position, in its frame, within reach, near the last one.

SI units, frame ``sheet``. The codes are those of docs/reference/error_codes.md.
"""

from __future__ import annotations

import math

import numpy as np

from isf_driver_example.hardware import Array

FRAME = "sheet"
SPEED = 0.25
"""m/s, most that a target may move at: of the machine, not of the part."""
FIRST_STEP = 2e-3
"""m, most from a tool at rest to its first target: who streams begins where the tools are."""
LONGEST_GAP = 0.25
"""s without a target that count for its way: later the sender stands still too, or is another one."""
TRAVEL = np.array([0.125, 0.125, 0.11])
"""m, that a tip may go from the origin along each axis."""
TARGET_NOT_FINITE, TARGET_JUMP, TARGET_OUT_OF_WORKSPACE = 1401, 1402, 1403


class TargetCheck:
    """Looks at one target after the other; ``period`` s is that of the targets."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._last: list[tuple[float, float, Array] | None] = [None, None]

    def restart(self) -> None:
        """The next targets are first ones."""
        self._last = [None, None]

    def check(self, tool: int, frame: str, tip: Array, here: Array, now: float, stamp: float) -> tuple[int, str] | None:
        """Code and text of what is wrong with the target ``tip`` (3,) m of ``tool`` (1, 2); None when it is right.

        ``here`` (3,) m is where the tool is, ``now`` s the time and ``stamp`` s that of the target (0: it has none): a
        driver that stood still itself receives at once what was left of many. A target that is wrong is not followed:
        the next one is compared with the one before.
        """
        name = f"tool_{tool}/target"
        if frame != FRAME:
            return TARGET_NOT_FINITE, f"{name} comes in frame '{frame}', not '{FRAME}'"
        if not np.isfinite(tip).all():
            return TARGET_NOT_FINITE, f"{name} is not a position"
        if (np.abs(tip) > TRAVEL).any():
            return TARGET_OUT_OF_WORKSPACE, f"{name} is outside the travel"
        last = self._last[tool - 1]
        if last is None:
            step, allowed = math.dist(tip, here), FIRST_STEP
        else:
            gap = min(max(now - last[0], stamp - last[1], self._period), LONGEST_GAP)
            step, allowed = math.dist(tip, last[2]), SPEED * gap
        if step > allowed:
            return TARGET_JUMP, f"{name} jumps by {1e3 * step:.1f} mm, {1e3 * allowed:.1f} mm are allowed"
        self._last[tool - 1] = (now, stamp, tip)
        return None
