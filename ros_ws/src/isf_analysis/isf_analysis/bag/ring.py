"""The last seconds of a cell in memory, for a bag that is written only when something goes wrong."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence

from isf_analysis.bag.recording import Message

EARLIER = 100
"""Messages that are kept of topics to which several nodes contribute: as many as tf2 keeps for late subscribers."""


class Ring:
    """Messages of the last ``span`` ns, in at most ``room`` bytes; of the topics ``latched`` the last one always.

    A latched topic tells what holds until the next message of it: job, plan, contour. Its last message is kept when it
    has left the span, since what follows cannot be understood without it. Of the topics ``joint`` several nodes tell
    their share, as of static transforms: the last EARLIER different messages are kept.
    """

    def __init__(self, span: int, room: int, latched: Collection[int], joint: Collection[int] = ()) -> None:
        self._span, self._room, self._latched, self._joint = span, room, frozenset(latched), frozenset(joint)
        self._messages: deque[Message] = deque()
        self._before: dict[int, Message] = {}
        self._shares: dict[tuple[int, bytes], Message] = {}
        self._bytes = 0

    def add(self, messages: Sequence[Message]) -> None:
        """Take messages in the order of their receipt; older ones go."""
        self._messages.extend(messages)
        self._bytes += sum(len(data) for _, _, data in messages)
        while self._messages and (self.held > self._span or self._bytes > self._room):
            old = self._messages.popleft()
            self._bytes -= len(old[2])
            if old[0] in self._joint:
                key = old[0], bytes(old[2])
                self._shares.pop(key, None)
                self._shares[key] = old
                if len(self._shares) > EARLIER:
                    del self._shares[next(iter(self._shares))]
            elif old[0] in self._latched:
                self._before[old[0]] = old

    @property
    def held(self) -> int:
        """ns from the first message to the last one."""
        return self._messages[-1][1] - self._messages[0][1] if self._messages else 0

    def messages(self) -> list[Message]:
        """What is held, in order; what holds from before the span stands at its begin, with the time of the first."""
        before = [*self._shares.values(), *self._before.values()]
        if not self._messages:
            return before
        begin = self._messages[0][1]
        return [(number, begin, data) for number, _, data in before] + list(self._messages)
