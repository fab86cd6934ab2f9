"""Processes that end with their owner, however that ends."""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Callable

_LIBC = ctypes.CDLL(None, use_errno=True)  # loaded here: between fork and exec as little as possible is done
_PR_SET_PDEATHSIG = 1
"""Of prctl(2): the signal that a process receives when the thread that started it ends, for whatever reason."""


def ends_with_owner(number: signal.Signals) -> Callable[[], None]:
    """For ``preexec_fn`` of subprocess: the process receives ``number`` when its owner is gone, however it ended.

    Start it from a thread that lasts as long as the owner does.
    """
    owner = os.getpid()

    def prepare() -> None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, number)
        if os.getppid() != owner:  # ended before the line above
            os._exit(1)

    return prepare
