"""Whether the process of a node still runs, seen from another process on the same computer; free of ROS.

Silence does not tell a process that ended from one that waits for a busy processor; the system does, at once.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

_PROCESSES = Path("/proc")


def identity() -> str:
    """Of this process: ``PID:START@COMPUTER``; empty where the system does not tell.

    START tells a process from a later one with the same number; COMPUTER is the running system and the container.
    """
    found = _stat(os.getpid())
    return f"{os.getpid()}:{found[1]}@{_computer()}" if found and _computer() else ""


def running(process: str) -> bool | None:
    """True when the process of that :func:`identity` runs, False when it has ended; None when that cannot be seen, as
    of another user, or when it is stopped (SIGSTOP, Ctrl-Z, a debugger): then it is not slow, and may never go on."""
    number, _, computer = process.partition("@")
    pid, _, start = number.partition(":")
    if not (pid.isdecimal() and start) or computer != _computer():
        return None
    found = _stat(int(pid))
    if found is None:
        return None if _exists(int(pid)) else False
    if found[0] in "Tt" and found[1] == start:
        return None
    return found[0] not in "ZX" and found[1] == start


def _stat(pid: int) -> tuple[str, str] | None:
    """State and start time (in ticks of the system) of a process; None when there is none, or it is not shown."""
    try:
        text = (_PROCESSES / str(pid) / "stat").read_text(errors="replace")
    except OSError:
        return None
    fields = text.rpartition(")")[2].split()  # the name before it may hold anything
    return fields[0], fields[19]


def _exists(pid: int) -> bool:
    """Asked in another way than /proc, where a system may hide the processes of other users (hidepid)."""
    try:
        os.kill(pid, 0)  # nothing is sent
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


@cache
def _computer() -> str:
    try:
        boot = (_PROCESSES / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot[:8]}-{(_PROCESSES / 'self/ns/pid').readlink().name}"
    except OSError:
        return ""
