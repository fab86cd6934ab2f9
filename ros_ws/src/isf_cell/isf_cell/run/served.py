"""Whether the node that serves an action is still there: the result of one that died would be waited for for ever."""

from __future__ import annotations

import time
from collections.abc import Callable

from isf_core.errors import ErrorCode, IsfError

GONE = 5.0
"""s without a server after which a node that another command started counts as gone."""


class Served:
    """``ready`` tells whether the node ``name`` serves the action."""

    def __init__(self, ready: Callable[[], bool], name: str) -> None:
        self._ready, self._name = ready, name
        self._seen = time.monotonic()

    def check(self) -> None:
        """To be called again and again; raises IsfError NODE_DIED when it has not been served for :data:`GONE` s."""
        now = time.monotonic()
        if self._ready():
            self._seen = now
        elif now > self._seen + GONE:
            raise IsfError(ErrorCode.NODE_DIED, f"{self._name} is gone", advice="start the cell again")
