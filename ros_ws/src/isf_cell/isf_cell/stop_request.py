"""Ctrl-C while a part is formed in this process: a wish to stop after the present contour."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from isf_cell import terminal


class StopRequest:
    """Before the first contour, and asked twice, it stops at once: there is nothing, or no time, to keep."""

    def __init__(self) -> None:
        self.contours = 0
        self.wanted = False

    def contour_formed(self) -> None:
        """From now on there is something to keep."""
        self.contours += 1

    def ask(self, _number: int = signal.SIGINT, _frame: FrameType | None = None) -> None:
        """Handler of the signal; raises KeyboardInterrupt to stop at once."""
        if self.wanted or not self.contours:
            raise KeyboardInterrupt
        self.wanted = True
        terminal.console.print("  stopping after this contour; Ctrl-C again stops at once and keeps nothing")


@contextmanager
def ctrl_c_stops_between_contours() -> Iterator[StopRequest]:
    """Ctrl-C goes to the request given; where it is handled otherwise, or ignored, nothing changes."""
    request = StopRequest()
    usual = signal.default_int_handler
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not usual:
        yield request
        return
    signal.signal(signal.SIGINT, request.ask)
    try:
        yield request
    finally:
        signal.signal(signal.SIGINT, usual)
