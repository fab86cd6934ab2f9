"""Ctrl-C raises KeyboardInterrupt in a command, but only where that does no harm."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_NOT_TO_BE_INTERRUPTED = ("/numba/", "<frozen importlib")
"""Parts of the names of files. Python code that a compiled function calls back (to load its constants, to box an array)
has nowhere to raise to: the process crashes or hangs. A library whose import is interrupted is left half imported."""


def interrupt(_number: int, frame: FrameType | None) -> None:
    """Handler of SIGINT: raises KeyboardInterrupt as Python's own, once compiled functions and imports are left."""
    safe, outer = frame, frame
    while outer is not None:
        if any(part in outer.f_code.co_filename for part in _NOT_TO_BE_INTERRUPTED):
            safe = outer.f_back
        outer = outer.f_back
    if safe is None or safe is frame:
        raise KeyboardInterrupt
    _raise_in(safe)


def _raise_in(frame: FrameType) -> None:
    """KeyboardInterrupt as soon as ``frame`` goes on.

    A signal sent again a little later would not do: where most of the time is spent in compiled functions, the first
    Python code after it would again be what such a function calls back.
    """

    def trace(traced: FrameType, _event: str, _argument: object) -> None:
        if traced is frame:
            frame.f_trace = None
            raise KeyboardInterrupt  # which ends the tracing

    frame.f_trace = trace
    sys.settrace(trace)


@contextmanager
def ctrl_c_handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Inside, ``handler`` takes SIGINT; where Ctrl-C does not raise KeyboardInterrupt, it stays as it is."""
    raises = signal.getsignal(signal.SIGINT) in (signal.default_int_handler, interrupt)
    if threading.current_thread() is not threading.main_thread() or not raises:
        yield
        return
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def ctrl_c_held_back() -> Iterator[Callable[[], None]]:
    """Inside, Ctrl-C waits until the function given is called, or for the end; there KeyboardInterrupt is raised.

    An executor that is interrupted between taking a message and handing it on never looks at that client again, so a
    part that Ctrl-C cancels would seem to give no answer.
    """
    asked: list[int] = []

    def let_through() -> None:
        if asked:
            asked.clear()
            raise KeyboardInterrupt

    with ctrl_c_handled_by(lambda number, _: asked.append(number)):
        yield let_through
    let_through()
