"""Order and age of the wrenches of one tool by their stamps: old and late ones, and clocks that jump.

The sender's clock need not agree with ours: a delay is what a message needs beyond the fastest one before.
"""

from __future__ import annotations

from isf_core.errors import ErrorCode

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
        self._name, self._most, self._late_for = f"tool_{tool}/wrench", most_delay, late_for
        self.old = self.late = 0
        """Wrenches with a stamp before the newest one; wrenches that came too late."""
        self.restart()

    def restart(self) -> None:
        """The sender may have started anew."""
        self._stamp: int | None = None
        self._received = self._fastest = 0.0
        self._late_since: float | None = None

    def look(self, stamp: int, now: float) -> tuple[bool, tuple[ErrorCode, str] | None]:
        """Is the wrench of ``stamp`` ns, received at ``now`` s (monotonic), to be used; and code and text of a fault.

        A wrench of the newest stamp itself is used: it repeats what is known.
        """
        last = self._stamp
        if last is None:
            self._stamp, self._received, self._fastest = stamp, now, now - stamp * _NANO
            return True, None
        step = (stamp - last) * _NANO
        passed = now - self._received if self._most < float("inf") else 0.0
        # Waiting messages may come all at once, so time that passed here excuses a step forwards, never one backwards.
        if step < -JUMP or step - passed > JUMP:
            return False, (
                ErrorCode.WRENCH_CLOCK,
                f"the stamps of {self._name} jumped by {step - passed:+.2f} s (clock set, or the driver started anew)",
            )
        if step < 0.0:
            self.old += 1
            return False, None
        self._stamp, self._received = stamp, now
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
        if now - self._late_since < self._late_for:
            return None
        return ErrorCode.WRENCH_LATE, (
            f"{self._name} comes {1e3 * over:.0f} ms later than at first, {1e3 * self._most:.0f} ms are allowed "
            "(check the network, and the load of this computer)"
        )
