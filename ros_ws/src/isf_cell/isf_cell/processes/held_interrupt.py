"""Ctrl-C kept for a safe place: in the middle of rclpy's executor it would lose what was just taken from DDS."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def ctrl_c_held_back() -> Iterator[Callable[[], None]]:
    """Inside, Ctrl-C waits until the function given is called, or for the end; there KeyboardInterrupt is raised.

    An executor that is interrupted between taking a message and handing it on never looks at that client again, so a
    part that Ctrl-C cancels would seem to give no answer. Where Ctrl-C is handled otherwise, or ignored, it stays so.
    """
    asked: list[int] = []

    def let_through() -> None:
        if asked:
            asked.clear()
            raise KeyboardInterrupt

    usual = signal.default_int_handler
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not usual:
        yield let_through
        return
    signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        yield let_through
    finally:
        signal.signal(signal.SIGINT, usual)
    let_through()
