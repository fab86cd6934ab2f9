"""Receives the wrenches of both tools: their frame, the order and age of their stamps, and the pair that a tick uses.

Forces in other axes than ``sheet`` would be pushed against in the wrong direction, so wrenches in another frame are
turned into them, or refused. s.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from isf_core.errors import ErrorCode, IsfError

Fault = tuple[ErrorCode, str]
"""Code and text."""

Reading = tuple[int, str, int, Sequence[float]]
"""Tool (1, 2), frame, stamp in ns, and wrench (6,), as :meth:`WrenchReceiver.add` takes them."""

Turned = Callable[[str, int, Sequence[float]], Sequence[float]]
"""A wrench (6,) in axes of a frame, read at a stamp in ns, as one in axes of the sheet. Raises IsfError WRENCH_FRAME
where nothing joins the two, POSE_LOST where what joins them is too old."""


class WrenchReceiver:
    """Wrenches in ``frame`` are taken as they are, others by ``turned``; ``most_delay`` (lockstep: inf) and
    ``late_for`` s as for :class:`StampWatch`."""

    def __init__(self, frame: str, turned: Turned, most_delay: float, late_for: float) -> None:
        self.frames = WrenchFrames(frame, turned)
        self.pair = WrenchPair()
        self._watches = tuple(StampWatch(tool, most_delay, late_for) for tool in (1, 2))
        self._by_clock = math.isfinite(most_delay)

    def restart(self) -> None:
        """Forget everything: the machine may have started anew with earlier stamps."""
        self.pair.restart()
        for watch in self._watches:
            watch.restart()

    def begin_contour(self) -> None:
        """In lockstep time may have gone on since the last contour, as a scan takes its time: that is no jump."""
        if not self._by_clock:
            for watch in self._watches:
                watch.time_may_have_gone_on()

    def add(self, tool: int, frame: str, stamp: int, wrench: Sequence[float]) -> tuple[bool, Fault | None]:
        """Take the wrench (6,) of ``tool`` (1, 2) with ``stamp`` ns.

        Returns whether it is a sign of life (an old one is none, nor one whose axes are not known for the moment) and
        code and text of what is wrong with it. By the clock, a driver that leaves its stamps at zero is taken at its
        word: now.
        """
        in_sheet = self.frames.in_sheet(tool, frame, stamp, wrench)
        if in_sheet is None:
            fault = self.frames.fault(tool)
            return (True, fault) if fault and fault[0] is ErrorCode.WRENCH_FRAME else (False, None)
        now = time.monotonic()
        if stamp == 0 and self._by_clock:
            stamp = int(now * 1e9)
        else:
            use, fault = self._watches[tool - 1].check(stamp, now)
            if not use:
                return fault is not None, fault
            if fault:
                return True, fault
        self.pair.add(tool, stamp, in_sheet)
        return True, None

    def late_for(self, tools: Sequence[int]) -> float:
        """s for which nothing but late wrenches has come from one of ``tools`` (1, 2)."""
        return max(self._watches[tool - 1].late_for() for tool in tools)

    def values(self) -> dict[str, object]:
        """For ``/diagnostics``: messages since the node was configured."""
        return {
            "old_wrenches": sum(watch.old for watch in self._watches),
            "late_wrenches": sum(watch.late for watch in self._watches),
        }


JUMP = 0.5
"""s by which a stamp and the clock of the receiver must disagree to be a jump of the sender's clock."""

DRIFT = 1e-3
"""s/s that two clocks may drift apart."""

_NANO = 1e-9


class StampWatch:
    """Looks at one stamp after the other.

    ``most_delay`` s beyond the fastest message; infinite: delays are not looked at, and a stamp may stand still and go
    on any time (lockstep, where time waits for the targets). ``late_for`` s of nothing but late wrenches are a fault.
    """

    def __init__(self, tool: int, most_delay: float, late_for: float) -> None:
        self._name, self._most, self._longest_late = f"tool_{tool}/wrench", most_delay, late_for
        self.old = self.late = 0
        """Wrenches with a stamp before the newest one; wrenches that came too late."""
        self.restart()

    def restart(self) -> None:
        """The sender may have started anew."""
        self._stamp: int | None = None
        self._received = self._fastest = 0.0
        self._late_since: float | None = None
        self._gone_on = False

    def late_for(self) -> float:
        """s from the first to the newest of the late wrenches that came without one in time between them."""
        return 0.0 if self._late_since is None else self._received - self._late_since

    def time_may_have_gone_on(self) -> None:
        """The next stamp may be later by any time; an earlier one is a jump as ever."""
        self._gone_on = True

    def check(self, stamp: int, now: float) -> tuple[bool, tuple[ErrorCode, str] | None]:
        """Is the wrench of ``stamp`` ns, received at ``now`` s (monotonic), to be used; and code and text of a fault.

        A wrench of the newest stamp itself is used: it repeats what is known.
        """
        last, gone_on = self._stamp, self._gone_on
        if last is None:
            self._gone_on = False
            self._stamp, self._received, self._fastest = stamp, now, now - stamp * _NANO
            return True, None
        step = (stamp - last) * _NANO
        by_the_clock = not math.isinf(self._most)
        passed = now - self._received if by_the_clock else 0.0
        # Waiting messages may come all at once, so time that passed here excuses a step forwards, never one backwards.
        # An old one may have waited until now, and the next one not: then it is only as quick as others were.
        ahead = self._fastest - (now - stamp * _NANO) if by_the_clock else math.inf
        if step < -JUMP or (min(step - passed, ahead) > JUMP and not gone_on):
            return False, (
                ErrorCode.WRENCH_CLOCK,
                f"the stamps of {self._name} jumped by {step - passed:+.2f} s (clock set, or the driver restarted)",
            )
        if step < 0.0:
            self.old += 1
            return False, None
        self._stamp, self._received, self._gone_on = stamp, now, False
        return True, self._delay_fault(now - stamp * _NANO, now, passed)

    def _delay_fault(self, delay: float, now: float, passed: float) -> tuple[ErrorCode, str] | None:
        self._fastest = min(delay, self._fastest + DRIFT * passed)
        over = delay - self._fastest
        if over <= self._most:
            self._late_since = None
            return None
        self.late += 1
        if self._late_since is None:
            self._late_since = now
        if now - self._late_since < self._longest_late:
            return None
        return ErrorCode.WRENCH_LATE, (
            f"{self._name} comes {1e3 * over:.0f} ms later than the first ones, {1e3 * self._most:.0f} ms are allowed "
            "(check the network, and the load of this computer)"
        )


_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class WrenchPair:
    """Collects wrenches (6,) of both tools by their stamps in ns."""

    def __init__(self) -> None:
        self.wrench: list[Sequence[float]] = [_NONE, _NONE]
        """Newest wrench of tool 1 and 2."""
        self._stamp = [-1, -1]
        self._fresh = [False, False]
        self._handled = -1

    def add(self, tool: int, stamp: int, wrench: Sequence[float]) -> None:
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

    def take_again(self) -> None:
        """The pair that was taken last may be taken once more."""
        self._handled = -1

    def reached(self, stamp: int) -> bool:
        """True when both wrenches are of ``stamp`` ns or later."""
        return min(self._stamp) >= stamp

    def fresh(self, tools: Sequence[int]) -> bool:
        """True when each of ``tools`` has a newer wrench than at the last :meth:`use` (real time)."""
        return all(self._fresh[tool - 1] for tool in tools)

    def use(self) -> None:
        """The newest wrenches are used, whatever their stamps."""
        self._fresh = [False, False]

    def restart(self) -> None:
        """Forget everything: the machine may have started anew with earlier stamps."""
        self._stamp, self._handled, self._fresh = [-1, -1], -1, [False, False]


class WrenchFrames:
    """Axes of the newest wrenches of both tools: those in ``frame`` are right, others are ``turned`` into them."""

    def __init__(self, frame: str, turned: Turned) -> None:
        self._frame, self._turned = frame, turned
        self._faults: list[IsfError | None] = [None, None]

    def in_sheet(self, tool: int, frame: str, stamp: int, wrench: Sequence[float]) -> Sequence[float] | None:
        """The ``wrench`` (6,) of ``tool`` (1, 2), read at ``stamp`` ns in axes of ``frame``, in axes of the sheet; None
        when they are not known."""
        self._faults[tool - 1] = None
        if frame == self._frame:
            return wrench
        try:
            return self._turned(frame, stamp, wrench)
        except IsfError as error:
            self._faults[tool - 1] = error
            return None

    def fault(self, tool: int) -> Fault | None:
        """Code and text of what is wrong with the frame of the newest wrench of ``tool`` (1, 2)."""
        error = self._faults[tool - 1]
        if error is None:
            return None
        text = f"tool_{tool}/wrench cannot be turned into axes of the sheet: {error.what}"
        if error.code is ErrorCode.WRENCH_FRAME:
            text += (
                " (have its transform published, as by robot_state_publisher or static_transform_publisher, or set the "
                "parameter wrench_frame where only the name differs)"
            )
        return error.code, text

    def check(self, tools: Sequence[int]) -> None:
        """Raise IsfError WRENCH_FRAME or POSE_LOST when the axes of the newest wrench of one of ``tools`` are not
        known."""
        for tool in tools:
            if fault := self.fault(tool):
                raise IsfError(*fault)
