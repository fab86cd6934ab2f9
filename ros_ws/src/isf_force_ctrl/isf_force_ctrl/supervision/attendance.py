"""Whether somebody is there to go on with a part whose tools form it or rest on the sheet.

Judged by wall time: simulated time stands still between contours in lockstep. A correction may take minutes, so its
length says nothing; what says something is whether the executive that has the part formed is alive and still at it.
Where there is none (another program arms and sends the contours) only the time since the last contour is left.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from isf_core.errors import ErrorCode, IsfError
from isf_ros.executive_watch import ExecutiveWatch

EXECUTIVE_SILENCE = 5.0
"""s of wall time without a sign of life after which the executive counts as gone; it tells of itself at 2 Hz."""

_ADVICE = "the tools are lifted off the sheet; arm again for the contours that are left"


class Attendance:
    """Watches over one armed plan; ``wait`` s on the sheet are allowed where no ``executive`` has the part formed."""

    def __init__(self, executive: ExecutiveWatch, wait: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.executive = executive
        self._wait, self._clock = wait, clock
        self._resting_since: float | None = None
        self._over = True

    def begin(self) -> None:
        """A plan was armed."""
        self._over, self._resting_since = False, None
        self.executive.release()

    def not_served(self) -> None:
        """This process stood still or was at work itself: signs of life and contours of that time are still to come."""
        self.executive.not_served()
        self._resting_since = None

    def judge(self, *, on_sheet: bool, forming: bool = False) -> IsfError | None:
        """To be asked often: why the tools must leave the sheet now, once per plan.

        EXECUTIVE_LOST or CONTOUR_OVERDUE; None while somebody is there, or nothing is ``on_sheet`` and no contour is
        being formed (``forming``). A contour is not formed to its end for an executive that is gone: it may take
        minutes, and a part that goes on begins with it again.
        """
        now = self._clock()
        if not (on_sheet or forming) or self._over:
            self._resting_since = None
            return None
        if not on_sheet:
            self._resting_since = None
        elif self._resting_since is None:
            self._resting_since = now
        alone = None
        if self.executive.followed:
            if gone := self.executive.gone():
                alone = IsfError(ErrorCode.EXECUTIVE_LOST, gone, advice=_ADVICE)
        elif self._resting_since is not None and now - self._resting_since > self._wait:
            what = f"no next contour for {self._wait:g} s with the tools on the sheet"
            alone = IsfError(ErrorCode.CONTOUR_OVERDUE, what, advice=f"{_ADVICE}; parameter contour_wait")
        self._over = alone is not None
        return alone
