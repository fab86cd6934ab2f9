"""Which nodes are alive, by the time their diagnostics arrived here; free of ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable


class HeartbeatMonitor:
    """Last sign of life of each expected node and the last failure it told.

    Parameters
    ----------
    names : nodes that are expected, without leading slash and namespace
    silence : s without a heartbeat after which a node that was heard once counts as dead
    """

    def __init__(self, names: Iterable[str], silence: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._names = tuple(names)
        self._silence = silence
        self._clock = clock
        self._heard: dict[str, float] = {}
        self._text: dict[str, str] = {}
        self._state: dict[str, str] = {}
        self._left: dict[str, str] = {}

    def hear(self, name: str, text: str, state: str = "") -> None:
        """A heartbeat came; ``text`` is what the node says of itself, ``state`` its lifecycle state when it told it."""
        if name not in self._names:
            return
        self._heard[name] = self._clock()
        self._text[name] = text
        if state == "active":
            self._left.pop(name, None)
        elif state and self._state.get(name) == "active":
            self._left[name] = state
        self._state[name] = state or self._state.get(name, "")

    def forget_states(self) -> None:
        """The nodes are brought up anew: what state they were in before says nothing."""
        self._state.clear()
        self._left.clear()

    def deactivated(self) -> dict[str, str]:
        """State of each node that was active and no longer is: somebody else took it down, or it was restarted."""
        return dict(self._left)

    def not_served(self) -> None:
        """This process stood still: what came meanwhile has not been heard yet."""
        self._heard = dict.fromkeys(self._heard, self._clock())

    def heard(self, name: str) -> bool:
        """True when the node was heard at least once."""
        return name in self._heard

    def silent(self) -> list[str]:
        """Nodes that were heard once and are silent for too long."""
        now = self._clock()
        return [name for name in self._names if name in self._heard and now - self._heard[name] > self._silence]

    def last_words(self, name: str) -> str:
        """What the node said last."""
        return self._text.get(name, "")
