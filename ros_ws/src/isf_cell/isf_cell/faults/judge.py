"""What the streams of a machine say of one fault: when the tools stood, when they were free, how large the forces were.

Free of ROS, and of everything that a cell decides by: it sees only what the machine measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from isf_core.types import Array, Indices

STANDING = 1e-3
"""m/s, speed along or into the sheet below which a tool stands: a fifth of the slowest feed of the part, at its seams;
upwards it is let go."""

STANDS_FOR = 0.1
"""s for which it has to stand."""

UNLOADED = 10.0
"""N, above drift, noise and crosstalk of the load cells; tools that form or rest on the sheet read hundreds."""


@dataclass(frozen=True)
class Trace:
    """What came on one topic.

    Attributes
    ----------
    received : (n,) ns since 1970, when it came ; stamp : (n,) ns, of the machine
    value : (n, 3) m or N
    """

    received: Indices
    stamp: Indices
    value: Array

    def __len__(self) -> int:
        return len(self.stamp)

    @property
    def size(self) -> Array:
        """(n,) m or N, length of each value."""
        return np.asarray(np.linalg.norm(self.value, axis=1))


@dataclass(frozen=True)
class Held:
    """How long after the fault the forming tool stood, s; by the ``machine`` time of the stamps and by the ``wall``
    clock of who received them."""

    machine: float
    wall: float


def held(pose: Trace, force: Trace, *, stamp: int, wall: int) -> Held:
    """When the forming tool stood, or was off the sheet, for ``STANDS_FOR``.

    ``pose``, ``force`` of that tool; the fault came at ``stamp`` of the machine and ``wall`` of the receiver, both ns.
    A tool that never stood counts until the machine told nothing any more; one of which nothing was told after the
    fault has no motion to judge: 0. Judged to the distance of two poses, upwards.
    """
    after = np.flatnonzero(pose.stamp > stamp)
    if len(after) < 2 or not len(force):
        return Held(0.0, 0.0)
    first = max(after[0] - 1, 0)
    times, way = pose.stamp[first:], np.diff(pose.value[first:], axis=0)
    way[:, 2] = np.minimum(way[:, 2], 0.0)
    step = np.diff(times)
    new = step > 0  # a machine that waits repeats itself
    speed = np.zeros(len(step))
    speed[new] = np.linalg.norm(way, axis=1)[new] / (1e-9 * step[new])
    loaded = force.size[np.clip(np.searchsorted(force.stamp, times[1:], side="right") - 1, 0, None)] > UNLOADED
    forming = np.flatnonzero((speed > STANDING) & loaded)
    if not len(forming):
        return Held(0.0, 0.0)
    ends = [k for k, later in zip(forming, [*forming[1:], -1], strict=True) if _stands(times, int(k), int(later))]
    end = first + 1 + int(ends[0])
    return Held(max(0.0, 1e-9 * (pose.stamp[end] - stamp)), max(0.0, 1e-9 * (pose.received[end] - wall)))


def _stands(times: Indices, last: int, later: int) -> bool:
    """Whether the motion that ends with step ``last`` is followed by a pause; ``later``: next step in motion, -1:
    none."""
    return later < 0 or 1e-9 * (times[later] - times[last + 1]) >= STANDS_FOR


def speed(pose: Trace, *, stamp: int, until: float = 0.0) -> float:
    """m/s, mean speed of a tool in the last 0.1 s before ``stamp`` (ns, of the machine), or that of its fastest step in
    the ``until`` s after it, where it is faster: a tool that leaves a seam still gathers speed."""
    span = np.flatnonzero((pose.stamp <= stamp) & (pose.stamp >= stamp - 100_000_000))
    before = 0.0
    if len(span) > 1 and (time := 1e-9 * float(pose.stamp[span[-1]] - pose.stamp[span[0]])) > 0.0:
        before = float(np.linalg.norm(np.diff(pose.value[span], axis=0), axis=1).sum() / time)
    after = np.flatnonzero((pose.stamp > stamp) & (pose.stamp <= stamp + 1e9 * until))
    way, times = np.diff(pose.value[after], axis=0), 1e-9 * np.diff(pose.stamp[after])
    steps = np.linalg.norm(way, axis=1)[times > 0.0] / times[times > 0.0]
    return max(before, float(steps.max(initial=0.0)))


ON_ITS_WAY = 0.5
"""s of the wall clock; a force that comes no later than that was told before the fault, on a busy computer."""


def released(forces: list[Trace], *, wall: int) -> float:
    """s of the wall clock after which no tool carried a force any more; infinite: never, NaN: nothing was measured.

    ``wall`` : ns, when the fault came.
    """
    latest = math.nan
    for force in forces:
        after = force.received > wall
        if not after.any():
            continue
        size = force.size
        loaded = np.flatnonzero(after & (size > UNLOADED))
        if len(loaded) and loaded[-1] == len(size) - 1:
            if 1e-9 * (force.received[-1] - wall) < ON_ITS_WAY:
                continue
            return math.inf
        last = 1e-9 * (force.received[loaded[-1] + 1] - wall) if len(loaded) else 0.0  # the first reading without
        latest = last if math.isnan(latest) else max(latest, last)
    return float(latest)


def worst(forces: list[Trace], limit: Array) -> float:
    """Largest component of any force as a share of its ``limit`` (3,) N."""
    return max((float((np.abs(force.value) / limit).max()) for force in forces if len(force)), default=0.0)
