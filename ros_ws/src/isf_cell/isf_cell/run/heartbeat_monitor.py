"""Which nodes are alive, by the time their signs of life arrived here and by their processes; free of ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from isf_ros.absence import absence
from isf_ros.process_identity import running


@dataclass
class _Heard:
    """What was heard of one node: ``at`` s of the clock; ``left`` is the state that it went to from active;
    ``earlier``: processes of its name that another came after, and how often one came back."""

    at: float
    process: str = ""
    text: str = ""
    state: str = ""
    left: str = ""
    version: str = ""
    earlier: dict[str, int] = field(default_factory=dict)


class HeartbeatMonitor:
    """Last sign of life of each expected node and the last failure it told.

    Which one is dead is said by :func:`isf_ros.absence.absence`.

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
        self._heard: dict[str, _Heard] = {}

    def hear(self, name: str, text: str, state: str = "", process: str = "", version: str = "") -> None:
        """A heartbeat came; ``text`` is what the node says of itself, ``state`` its lifecycle state, ``process`` the
        identity of its process and ``version`` that of its software when it told them."""
        node = self._sign_of(name)
        if node is None:
            return
        node.text = text
        if process and process != node.process:
            if node.process:
                node.earlier[node.process] = node.earlier.get(node.process, -1) + 1
            node.process = process
        node.version = version or node.version
        if state == "active":
            node.left = ""
        elif state and node.state == "active":
            node.left = state
        node.state = state or node.state

    def stream(self, name: str) -> None:
        """A message of another kind came from the node."""
        self._sign_of(name)

    def forget(self) -> None:
        """The nodes are brought up anew: what was heard of them before says nothing."""
        self._heard = {}

    def deactivated(self) -> dict[str, str]:
        """State of each node that was active and no longer is: somebody else took it down, or it was restarted."""
        return {name: node.left for name, node in list(self._heard.items()) if node.left}

    def not_served(self) -> None:
        """This process stood still: what came meanwhile has not been heard yet."""
        for node in list(self._heard.values()):
            node.at = self._clock()

    def twice(self) -> dict[str, list[str]]:
        """Processes of each name that two living ones have: they are seen to run, or are heard by turns. One that was
        started again has the name of the one that ended, and counts once."""
        found = {}
        for name, node in list(self._heard.items()):
            others = [p for p, again in node.earlier.items() if p != node.process and (again or self._runs(p))]
            if others:
                found[name] = sorted([node.process, *others])
        return found

    def versions(self) -> dict[str, str]:
        """Version of the software of each node that told it."""
        return {name: node.version for name, node in list(self._heard.items()) if node.version}

    def heard(self, name: str) -> bool:
        """True when the node was heard at least once."""
        return name in self._heard

    def dead(self) -> list[str]:
        """Nodes that were heard once and are gone."""
        now, heard = self._clock(), dict(self._heard)
        return [
            name
            for name in self._names
            if (node := heard.get(name)) and absence(now - node.at, self._silence, node.process, self._runs)
        ]

    def last_words(self, name: str) -> str:
        """What the node said last."""
        node = self._heard.get(name)
        return node.text if node else ""

    def _sign_of(self, name: str) -> _Heard | None:
        """Take note that ``name`` lives; None for one that is not expected."""
        if name not in self._names:
            return None
        now = self._clock()
        node = self._heard.setdefault(name, _Heard(now))
        node.at = now
        return node
