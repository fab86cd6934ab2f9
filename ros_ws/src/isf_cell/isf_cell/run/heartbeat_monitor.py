"""Which nodes are alive, by the time their signs of life arrived here and by their processes; free of ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from isf_ros.process_identity import running

LONGEST_SILENCE = 20.0
"""s of silence after which a node hangs although its process runs: as long as it may be in one callback
(LONGEST_BUSY of :mod:`isf_ros.busy_heartbeat`)."""


class HeartbeatMonitor:
    """Last sign of life of each expected node and the last failure it told.

    A node whose process is seen to have ended is dead at once. One whose process is seen running is slow, as on a busy
    computer, up to LONGEST_SILENCE. Where the process cannot be seen (another computer or container, a driver that does
    not tell it) it is dead after the silence.

    Parameters
    ----------
    names : nodes that are expected, without leading slash and namespace
    silence : s without a sign of life after which a node that was heard once counts as dead
    runs : whether the process of an identity runs, None: not known
    """

    def __init__(
        self,
        names: Iterable[str],
        silence: float,
        clock: Callable[[], float] = time.monotonic,
        runs: Callable[[str], bool | None] = running,
    ) -> None:
        self._names = tuple(names)
        self._silence = silence
        self._clock = clock
        self._runs = runs
        self._heard: dict[str, float] = {}
        self._process: dict[str, str] = {}
        self._text: dict[str, str] = {}
        self._state: dict[str, str] = {}
        self._left: dict[str, str] = {}

    def hear(self, name: str, text: str, state: str = "", process: str = "") -> None:
        """A heartbeat came; ``text`` is what the node says of itself, ``state`` its lifecycle state and ``process`` the
        identity of its process when it told them."""
        if name not in self._names:
            return
        self._heard[name] = self._clock()
        self._text[name] = text
        if process:
            self._process[name] = process
        if state == "active":
            self._left.pop(name, None)
        elif state and self._state.get(name) == "active":
            self._left[name] = state
        self._state[name] = state or self._state.get(name, "")

    def stream(self, name: str) -> None:
        """A message of another kind came from the node."""
        if name in self._names:
            self._heard[name] = self._clock()

    def forget(self) -> None:
        """The nodes are brought up anew: what was heard of them before says nothing."""
        for told in (self._heard, self._process, self._text, self._state, self._left):
            told.clear()

    def deactivated(self) -> dict[str, str]:
        """State of each node that was active and no longer is: somebody else took it down, or it was restarted."""
        return dict(self._left)

    def not_served(self) -> None:
        """This process stood still: what came meanwhile has not been heard yet."""
        self._heard = dict.fromkeys(self._heard, self._clock())

    def heard(self, name: str) -> bool:
        """True when the node was heard at least once."""
        return name in self._heard

    def dead(self) -> list[str]:
        """Nodes that were heard once and are gone."""
        now = self._clock()
        return [name for name in self._names if name in self._heard and self._is_gone(name, now - self._heard[name])]

    def last_words(self, name: str) -> str:
        """What the node said last."""
        return self._text.get(name, "")

    def _is_gone(self, name: str, silent: float) -> bool:
        process = self._process.get(name, "")
        runs = self._runs(process) if process else None
        if runs is None:
            return silent > self._silence
        return not runs or silent > max(self._silence, LONGEST_SILENCE)
