"""Who jogs a tool, and what the last message of that one asks for. Wall time at the receiver decides; no ROS here."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

Vector = tuple[float, float, float]

SILENCE = 0.15
"""s of wall time without a message after which the button counts as let go."""

SAME = 0.98
"""Cosine of the angle within which two directions are the same key."""

INCREMENTS = (0.01e-3, 0.1e-3, 1e-3, 10e-3, 0.0)
"""m, steps to choose from (Torrao 2013, 6.1.3 has selectable increments without their sizes: these are chosen);
0: as long as the key is pressed."""


@dataclass(frozen=True)
class JogDemand:
    """One message: fields as in ``isf_msgs/Jog``, the direction of any length."""

    client: str
    enable: bool
    tool: int
    direction: Vector
    increment: float
    speed: float = 0.0

    @property
    def key(self) -> Vector | None:
        """Unit direction; None: no key is pressed, or the direction is no number."""
        size = math.hypot(*self.direction)
        if not (math.isfinite(size) and size > 1e-6):
            return None
        x, y, z = self.direction
        return x / size, y / size, z / size


class Wish(Enum):
    """What follows from a message."""

    NOTHING = 0
    START = 1
    STOP = 2
    TAKEN = 3
    """Somebody else moves a tool."""
    LET_GO = 4
    """The client was lost with its key pressed, and still presses it: it has to be let go first."""


class JogDesk:
    """Gives the tools to one client at a time; ``clock`` in s."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.owner = ""
        """Who has the tools; empty: nobody."""
        self._watched = False
        self._heard = -math.inf
        self._key: Vector | None = None
        self._begun = False
        self._to_let_go = ""

    def take(self, client: str, *, watched: bool) -> bool:
        """Give the tools to ``client``, unless another one has them; ``watched``: it has to be heard from now on."""
        if self.owner not in ("", client) and not self.lost():
            return False
        self.owner, self._watched, self._heard = client, watched, self._clock()
        self._key, self._begun = None, False
        return True

    def release(self, *, lost: bool = False) -> None:
        """Nobody has the tools; ``lost``: who had them was lost, and moves none before the keys were let go."""
        self._to_let_go = self.owner if lost else ""
        self.owner, self._watched, self._key, self._begun = "", False, None, False

    def lost(self) -> bool:
        """True when who has the tools was not heard for :data:`SILENCE`."""
        return bool(self.owner) and self._watched and self._clock() - self._heard > SILENCE

    def not_served(self) -> None:
        """Nobody could be heard until now, for the receiver stood still itself: the silence counts anew."""
        self._heard = self._clock()

    def begun(self) -> None:
        """The movement that was wished for has begun, or was refused: the key has to be pressed anew for another."""
        self._begun = True

    def hear(self, demand: JogDemand) -> Wish:
        """Take a message."""
        key = demand.key
        if self.owner not in ("", demand.client) and not self.lost():
            return Wish.TAKEN if demand.enable and key is not None else Wish.NOTHING
        if not demand.enable:
            if self.owner == demand.client:
                self.release()
                return Wish.STOP
            return Wish.NOTHING
        if self.owner != demand.client:
            self.take(demand.client, watched=True)
        self._heard = self._clock()
        before, self._key = self._key, key
        if key is None:
            self._begun, self._to_let_go = False, ""
            return Wish.STOP if before is not None and demand.increment <= 0.0 else Wish.NOTHING
        if before is not None and sum(a * b for a, b in zip(before, key, strict=True)) < SAME:
            self._begun = False
            return Wish.STOP
        if self._to_let_go == demand.client:
            return Wish.LET_GO
        return Wish.NOTHING if self._begun else Wish.START
