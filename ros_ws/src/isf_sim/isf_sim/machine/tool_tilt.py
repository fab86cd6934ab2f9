"""The tilt of the upper tool: its axis follows what is asked for as the other axes follow theirs, within limits.

Frame ``sheet``, rad. A machine that cannot tilt its tool refuses every axis that is not upright.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.hexapod import rotation
from isf_core.geometry.tool_axis import UNIT_TOLERANCE, UPRIGHT, axis_of, tilt_of
from isf_core.types import Array

from isf_sim.machine.axes import ServoConstants, follow_targets

LARGEST_TURN = math.radians(1.0)
"""rad, that the asked axis may turn in one tick (assumed): what turns faster is a jump, as of a wrong message."""
_ROUNDING = 1e-9
"""rad, beyond the largest tilt."""
_STRAIGHT = 1.0e-4
"""rad, within which a platform on legs counts as upright again."""


@dataclass
class ToolTilt:
    """Tilt about x, then y.

    Attributes
    ----------
    asked : axis asked for last ; target : (2,) rad, its tilt
    state : (2, 3) tilt, its rate and acceleration, as the encoders tell
    upright : the tool was never tilted, or has come to rest upright again
    """

    asked: tuple[float, float, float] = UPRIGHT
    target: Array = field(default_factory=lambda: np.zeros(2))
    state: Array = field(default_factory=lambda: np.zeros((2, 3)))
    upright: bool = True

    @property
    def axis(self) -> tuple[float, float, float]:
        """(3,) unit, where the axis is."""
        if self.upright:
            return UPRIGHT
        x, y, z = axis_of(self.state[:, 0]).tolist()
        return x, y, z

    @property
    def turn(self) -> Array | None:
        """(3, 3) from axes of the tool to frame ``sheet``; None: the same."""
        return None if self.upright else rotation(self.state[:, 0])

    def ask(self, axis: Sequence[float], limit: float, waited: int = 0) -> None:
        """The next tick goes towards ``axis`` (3,), tilted by at most ``limit`` rad; ``waited``: ticks left out before.

        Raises
        ------
        IsfError : TARGET_NOT_FINITE (no unit vector), TARGET_OUT_OF_WORKSPACE (tilted too far), TARGET_JUMP
        """
        x, y, z = (float(value) for value in axis)
        told = f"({x:.4f}, {y:.4f}, {z:.4f})"
        if not abs(math.sqrt(x * x + y * y + z * z) - 1.0) <= UNIT_TOLERANCE:
            raise IsfError(ErrorCode.TARGET_NOT_FINITE, f"the axis {told} of the tool is no direction")
        tilt = math.atan2(math.hypot(x, y), z)
        if tilt > limit + _ROUNDING:
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE,
                f"the axis {told} of the tool is tilted by {math.degrees(tilt):.2f} deg, this machine can tilt it by "
                f"{math.degrees(limit):.2f} deg",
            )
        turned = math.acos(min(1.0, sum(a * b for a, b in zip((x, y, z), self.asked, strict=True))))
        if turned > LARGEST_TURN * (1 + waited):
            raise IsfError(
                ErrorCode.TARGET_JUMP,
                f"the axis of the tool turns by {math.degrees(turned):.2f} deg in one tick, "
                f"{math.degrees(LARGEST_TURN * (1 + waited)):.2f} deg allowed",
            )
        self.asked = (x, y, z)
        self.upright = self.upright and self.asked == UPRIGHT

    def follow(self, servo: ServoConstants) -> None:
        """One control tick towards what was asked for last."""
        end = tilt_of(np.array(self.asked))
        follow_targets(self.state, self.target, end, servo)
        self.target = end
        if self.asked == UPRIGHT and np.abs(self.state[:, 0]).max() < 1e-9 and np.abs(self.state[:, 1]).max() < 1e-7:
            self.state[:] = 0.0
            self.upright = True

    def tell(self, tilt: Array) -> None:
        """The encoders of legs tell the ``tilt`` (2,) rad; they, not a servo, follow what was asked for."""
        self.target = tilt_of(np.array(self.asked))
        self.state[:, 0] = tilt
        if self.asked == UPRIGHT and np.abs(tilt).max() < _STRAIGHT:
            self.state[:] = 0.0
            self.upright = True
