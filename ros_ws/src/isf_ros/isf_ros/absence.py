"""When a node that was heard counts as gone: one rule for everybody who follows others; free of ROS."""

from __future__ import annotations

from collections.abc import Callable

from isf_ros.busy_heartbeat import LONGEST_BUSY
from isf_ros.process_identity import running

ENDED = "has ended"


def absence(silent: float, patience: float, process: str, runs: Callable[[str], bool | None] = running) -> str:
    """What to say of a node that is gone; empty: it is there, or slow.

    ``silent`` s have passed since it was heard. A node whose ``process`` (identity, empty: not told) is seen to have
    ended is gone at once. One whose process is seen running is slow, as on a busy computer, for LONGEST_BUSY of
    :mod:`isf_ros.busy_heartbeat`. Where the process cannot be seen (another computer, container or user, a driver that
    does not tell it) it is gone after ``patience`` s.
    """
    seen = runs(process) if process else None
    if seen is False:
        return ENDED
    longest = max(patience, LONGEST_BUSY) if seen else patience
    return f"has given no sign of life for {longest:g} s" if silent > longest else ""
