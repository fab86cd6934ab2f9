"""How one frame stands in another, from the transforms between neighbours that drivers publish: rotations alone.

A transform says how the axes of a ``child`` frame stand in those of its ``parent``; every child has one parent, so the
frames form trees (ROS REP 105). The newest transform of every pair counts, whenever it was measured: a load cell needs
the present axes, and readings wait for nothing. Transforms that change grow old; fixed ones (``/tf_static``) do not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from scipy.spatial.transform import Rotation

UNIT = 1e-3
"""Largest deviation of a quaternion's length from 1: further off, nobody has filled it in."""


@dataclass(frozen=True)
class Link:
    """Axes of a child frame in those of ``parent``: ``quaternion`` (x, y, z, w); ``until`` s of the clock it counts."""

    parent: str
    quaternion: tuple[float, ...]
    until: float


@dataclass(frozen=True)
class Turn:
    """``matrix`` (3, 3) from axes of one frame to those of another, good ``until`` s of the clock; ``links`` are the
    children whose transforms it was made from: no other one changes it."""

    matrix: Array
    until: float
    links: frozenset[str]


class FrameTree:
    """The newest transforms; those that change count for ``timeout`` s of ``clock`` (monotonic by default)."""

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._timeout, self._clock = timeout, clock
        self._links: dict[str, Link] = {}

    def add(self, parent: str, child: str, quaternion: Sequence[float], *, fixed: bool = False) -> bool:
        """Take the axes of ``child`` in those of ``parent``, (x, y, z, w); False when that is no rotation."""
        if not abs(math.hypot(*quaternion) - 1.0) < UNIT:
            return False
        until = math.inf if fixed else self._clock() + self._timeout
        self._links[child] = Link(parent, tuple(quaternion), until)
        return True

    def rotation(self, base: str, frame: str) -> Turn:
        """From axes of ``frame`` to axes of ``base``.

        Raises IsfError POSE_LOST where the two do not hang together, or by a transform that is too old.
        """
        up, down = self._way_up(frame), self._way_up(base)
        while up and down and up[-1] == down[-1]:  # what both have above them does not matter
            up.pop()
            down.pop()
        tops = [self._links[way[-1]].parent if way else start for way, start in ((up, frame), (down, base))]
        if tops[0] != tops[1]:
            raise self._apart(base, frame, *tops)
        until = min((self._links[child].until for child in (*up, *down)), default=math.inf)
        if not self._clock() <= until:
            old = min((*up, *down), key=lambda child: self._links[child].until)
            what = f"how '{old}' stands in '{self._links[old].parent}' is more than {self._timeout:g} s old"
            raise IsfError(ErrorCode.POSE_LOST, what, advice="check the driver that publishes it")
        return Turn(self._product(down).T @ self._product(up), until, frozenset((*up, *down)))

    def _way_up(self, frame: str) -> list[str]:
        """Frames from ``frame`` to the one below the top of its tree. Raises IsfError POSE_LOST when they go round."""
        way: list[str] = []
        while frame in self._links:
            if frame in way:
                what = f"the transforms of {', '.join(repr(name) for name in way[way.index(frame) :])} form a ring"
                raise IsfError(
                    ErrorCode.POSE_LOST, what, advice="ros2 run tf2_tools view_frames shows who publishes them"
                )
            way.append(frame)
            frame = self._links[frame].parent
        return way

    def _product(self, way: Sequence[str]) -> Array:
        """(3, 3) from axes of the first frame of a way up to axes of the parent of the last one."""
        if not way:
            return np.eye(3)
        turns = Rotation.from_quat([self._links[child].quaternion for child in reversed(way)]).as_matrix()
        return np.asarray(reduce(np.matmul, turns))

    def _apart(self, base: str, frame: str, top: str, base_top: str) -> IsfError:
        known = {*self._links, *(link.parent for link in self._links.values())}
        missing = [name for name in (frame, base) if name not in known]
        if missing:
            what = f"nothing is known of frame {' and '.join(repr(name) for name in missing)}"
        else:
            what = f"'{frame}' hangs below '{top}', '{base}' below '{base_top}', and nothing joins the two"
        return IsfError(ErrorCode.POSE_LOST, what)
