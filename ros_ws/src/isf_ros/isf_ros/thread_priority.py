"""Real-time scheduling of this process's threads and locked memory, as far as the system permits (Linux).

All threads are raised, not the control thread alone: a wrench comes through the receiving threads of the middleware,
and with all cores busy a message waits in an ordinary one for several milliseconds.
"""

from __future__ import annotations

import ctypes
import os
import sys
from dataclasses import dataclass
from pathlib import Path

MAXIMUM_PRIORITY = 98
"""Highest SCHED_FIFO priority that may be asked for; 99 belongs to the kernel."""

SWITCH_INTERVAL = 0.0005
"""s after which a Python thread that computes lets another one have a turn; 5 ms otherwise."""

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4


@dataclass(frozen=True)
class RealTimeSettings:
    """What to ask the system for.

    ``priority``: SCHED_FIFO 1..98, 0 = ordinary scheduling; ``lock_memory``: pages in use stay in memory.
    """

    priority: int = 0
    lock_memory: bool = False


@dataclass(frozen=True)
class Privileges:
    """What was asked for and what the system granted.

    ``ordinary``: scheduling of each raised thread (id, policy, priority) before, for :func:`release`.
    """

    asked: RealTimeSettings = RealTimeSettings()
    fifo: bool = False
    locked: bool = False
    reason: str = ""
    ordinary: tuple[tuple[int, int, int], ...] = ()
    switch_interval: float = 0.005

    @property
    def priority(self) -> int:
        """SCHED_FIFO priority of the threads, 0: ordinary scheduling."""
        return self.asked.priority if self.fifo else 0

    @property
    def below(self) -> int:
        """Priority of a thread that must not hold up the others, 0: ordinary scheduling."""
        return max(self.priority - 1, 0)

    def values(self) -> dict[str, object]:
        """For ``/diagnostics``."""
        return {
            "real_time_priority": self.priority,
            "memory_locked": self.locked,
            **({"real_time_refused": self.reason} if self.reason else {}),
        }


def acquire(settings: RealTimeSettings) -> Privileges:
    """Ask for ``settings``; what is refused is told in ``reason``, and everything works without it."""
    interval = sys.getswitchinterval()
    refused = []
    ordinary: list[tuple[int, int, int]] = []
    if settings.priority > 0:
        try:
            ordinary = _raise_threads(settings.priority)
        except (OSError, AttributeError) as error:
            refused.append(f"SCHED_FIFO {settings.priority}: {error}")
        sys.setswitchinterval(SWITCH_INTERVAL)
    locked = False
    if settings.lock_memory:
        error_number = _memory_call("mlockall", _CURRENT | _FUTURE | _ON_FAULT)
        locked = error_number == 0
        if not locked:
            refused.append(f"mlockall: {os.strerror(error_number)}")
    return Privileges(settings, bool(ordinary), locked, "; ".join(refused), tuple(ordinary), interval)


def release(privileges: Privileges) -> None:
    """Give back what :func:`acquire` got."""
    for thread, policy, priority in privileges.ordinary:
        try:
            os.sched_setscheduler(thread, policy, os.sched_param(priority))
        except OSError:
            continue  # the thread has ended
    if privileges.locked:
        _memory_call("munlockall")
    sys.setswitchinterval(privileges.switch_interval)


def _raise_threads(priority: int) -> list[tuple[int, int, int]]:
    """Scheduling before; threads that they start later inherit the priority. Raises OSError when not permitted."""
    before = []
    for entry in sorted(Path("/proc/self/task").iterdir()):
        thread = int(entry.name)
        try:
            before.append((thread, os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority))
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
        except ProcessLookupError:  # it has ended meanwhile
            continue
    return before


def _memory_call(name: str, *arguments: int) -> int:
    """0, or the error number of a call of the C library about memory locks."""
    call = getattr(ctypes.CDLL(None, use_errno=True), name, None)
    if call is None:
        return 38  # ENOSYS
    return 0 if call(*arguments) == 0 else ctypes.get_errno()
