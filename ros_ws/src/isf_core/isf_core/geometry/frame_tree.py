"""How one frame stands in another, from the transforms between neighbours that drivers publish: rotations alone.

A transform says how the axes of a ``child`` frame stand in those of its ``parent``; every child has one parent, so the
frames form trees (ROS REP 105). :meth:`FrameTree.rotation` takes the newest transform of every pair, whenever it was
measured: for a reader that waits for nothing and trusts no stamps. :meth:`FrameTree.rotation_at` asks for the moment of
a stamp. Transforms that change grow old; fixed ones (``/tf_static``) do not.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np
from scipy.spatial.transform import Rotation

from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

UNIT = 1e-3
"""Largest deviation of a quaternion's length from 1: further off, nobody has filled it in."""

KEPT = 1.0
"""s of transforms that are kept, back from the newest one."""

NAMED = 12
"""Most frames that a text lists."""

Sample = tuple[float, tuple[float, ...]]
"""Stamp in s, and quaternion (x, y, z, w)."""


@dataclass
class Link:
    """Axes of a child frame in those of ``parent``: ``samples`` in order of their stamps, the newest last; ``until`` s
    of the clock that one counts."""

    parent: str
    until: float
    samples: deque[Sample] = field(default_factory=deque)

    @property
    def fixed(self) -> bool:
        """True of a transform that never changes."""
        return math.isinf(self.until)

    def add(self, stamp: float, quaternion: tuple[float, ...]) -> None:
        """Take a sample; a stamp before the newest one is that of a clock that was set, and begins anew."""
        if self.samples and stamp < self.samples[-1][0]:
            self.samples.clear()
        if self.samples and stamp == self.samples[-1][0]:
            self.samples.pop()
        self.samples.append((stamp, quaternion))
        while self.samples[0][0] < stamp - KEPT:
            self.samples.popleft()

    def around(self, stamp: float) -> tuple[Sample, Sample]:
        """The samples before and after ``stamp``; where it lies beyond those there are, the nearest one twice."""
        newest = self.samples[-1]
        if self.fixed or stamp >= newest[0]:
            return newest, newest
        later = newest
        for sample in reversed(self.samples):
            if sample[0] <= stamp:
                return sample, later
            later = sample
        return later, later


@dataclass(frozen=True)
class Turn:
    """``matrix`` (3, 3) from axes of one frame to those of another, good from ``since`` until ``until`` s of what it
    was asked by: the clock, or stamps. ``links`` are the children whose transforms it was made from: no other one
    changes it."""

    matrix: Array
    until: float
    links: frozenset[str]
    since: float = -math.inf


@dataclass(frozen=True)
class Way:
    """How two frames hang together: the children whose transforms lead ``up`` from the one, and ``down`` to the other,
    each from the frame itself to the one below what both have above them."""

    up: tuple[str, ...]
    down: tuple[str, ...]

    @property
    def links(self) -> frozenset[str]:
        """All of them."""
        return frozenset((*self.up, *self.down))


class FrameTree:
    """The transforms of the last moments; those that change count for ``timeout`` s: of ``clock`` (monotonic by
    default) since they came, or of stamps since they were measured."""

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._timeout, self._clock = timeout, clock
        self._links: dict[str, Link] = {}

    def add(
        self, parent: str, child: str, quaternion: Sequence[float], *, fixed: bool = False, stamp: float = 0.0
    ) -> bool:
        """Take the axes of ``child`` in those of ``parent``, (x, y, z, w), as measured at ``stamp`` s; False when that
        is no rotation."""
        if not abs(math.hypot(*quaternion) - 1.0) < UNIT:
            return False
        until = math.inf if fixed else self._clock() + self._timeout
        link = self._links.get(child)
        if link is None or link.parent != parent or link.fixed != fixed:
            link = self._links[child] = Link(parent, until)
        link.until = until
        link.add(0.0 if fixed else stamp, tuple(quaternion))
        return True

    def rotation(self, base: str, frame: str) -> Turn:
        """From axes of ``frame`` to axes of ``base``, by what came last.

        Raises IsfError POSE_LOST where the two do not hang together, or by a transform that is too old.
        """
        way = self.way(base, frame)
        until = min((self._links[child].until for child in way.links), default=math.inf)
        if not self._clock() <= until:
            old = min((*way.up, *way.down), key=lambda child: self._links[child].until)
            raise self._too_old(old, f"is more than {self._timeout:g} s old")
        newest = {child: self._links[child].samples[-1] for child in way.links}
        return Turn(_product(way, {child: (sample, sample) for child, sample in newest.items()}, 0.0), until, way.links)

    def rotation_at(self, base: str, frame: str, stamp: float) -> Turn:
        """From axes of ``frame`` to axes of ``base`` at ``stamp`` s: between two transforms on the shortest arc; where
        there is none after it yet, as the newest one says.

        The turn is good for other stamps as well where nothing lies between transforms: from ``since`` until ``until``.
        Raises IsfError POSE_LOST where the two do not hang together, or by a transform that is too old, or too new.
        """
        way = self.way(base, frame)
        moving = [child for child in (*way.up, *way.down) if not self._links[child].fixed]
        around = {child: self._links[child].around(stamp) for child in way.links}
        for child in moving:
            before, after = around[child]
            if before is after and not abs(stamp - before[0]) <= self._timeout:
                apart = f"{abs(stamp - before[0]):.2f} s {'older' if before[0] < stamp else 'newer'} than the reading"
                raise self._too_old(child, f"was measured {apart}, {self._timeout:g} s are allowed")
        newest = [self._links[child].samples[-1][0] for child in moving]
        since = max(newest, default=-math.inf)
        until = min(newest, default=math.inf) + self._timeout if since <= stamp else stamp
        return Turn(_product(way, around, stamp), until, way.links, since if since <= stamp else stamp)

    def way(self, base: str, frame: str) -> Way:
        """How the two hang together. Raises IsfError POSE_LOST where they do not."""
        up, down = self._way_up(frame), self._way_up(base)
        while up and down and up[-1] == down[-1]:  # what both have above them does not matter
            up.pop()
            down.pop()
        tops = [self._links[way[-1]].parent if way else start for way, start in ((up, frame), (down, base))]
        if tops[0] != tops[1]:
            raise self._apart(base, frame, *tops)
        return Way(tuple(up), tuple(down))

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

    def _apart(self, base: str, frame: str, top: str, base_top: str) -> IsfError:
        known = {*self._links, *(link.parent for link in self._links.values())}
        missing = [name for name in (frame, base) if name not in known]
        if missing:
            names = ", ".join(sorted(known)[:NAMED]) + (", ..." if len(known) > NAMED else "")
            what = (
                f"nothing is known of frame {' and '.join(repr(name) for name in missing)} (known: {names or 'none'})"
            )
        else:
            what = f"'{frame}' hangs below '{top}', '{base}' below '{base_top}', and nothing joins the two"
        return IsfError(ErrorCode.POSE_LOST, what)

    def _too_old(self, child: str, how: str) -> IsfError:
        what = f"how '{child}' stands in '{self._links[child].parent}' {how}"
        return IsfError(ErrorCode.POSE_LOST, what, advice="check the driver that publishes it")


def _product(way: Way, around: dict[str, tuple[Sample, Sample]], stamp: float) -> Array:
    """(3, 3) from axes of the frame below ``way.up`` to axes of the one below ``way.down``, at ``stamp`` s."""
    if not way.links:
        return np.eye(3)
    chain = [*reversed(way.up), *reversed(way.down)]
    pairs = [around[child] for child in chain]
    turns = Rotation.from_quat([before[1] for before, _ in pairs])
    if any(before is not after for before, after in pairs):
        share = [[(stamp - a[0]) / (b[0] - a[0]) if a is not b else 0.0] for a, b in pairs]
        further = turns.inv() * Rotation.from_quat([after[1] for _, after in pairs])
        turns = turns * Rotation.from_rotvec(np.array(share) * further.as_rotvec())
    matrices, count = turns.as_matrix(), len(way.up)
    up, down = (reduce(np.matmul, part, np.eye(3)) for part in (matrices[:count], matrices[count:]))
    return np.asarray(down.T @ up)
