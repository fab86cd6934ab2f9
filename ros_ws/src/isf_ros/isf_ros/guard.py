"""Callbacks that cannot end their process: what they raise is handed over instead."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

Failed = Callable[..., Any]
"""Called with the exception and the arguments of the callback; what it returns is the callback's answer."""


def guarded(callback: Callable[..., Any], failed: Failed) -> Callable[..., Any]:
    """``callback`` (a function or a coroutine function) that calls ``failed`` instead of raising an exception."""
    if inspect.iscoroutinefunction(callback):

        @functools.wraps(callback)
        async def serve(*arguments: Any) -> Any:
            try:
                return await callback(*arguments)
            except Exception as error:
                return failed(error, *arguments)
    else:

        @functools.wraps(callback)
        def serve(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                return failed(error, *arguments)

    return serve


def refuse(response: Any, code: int, text: str) -> Any:
    """``response`` of a service or action with ``code`` and ``text`` where it has a place for them."""
    for name, value in (("code", code), ("success", False), ("message", text)):
        if hasattr(response, name):
            setattr(response, name, value)
    return response
