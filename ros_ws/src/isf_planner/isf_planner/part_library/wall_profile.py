"""Wall profiles: height over the distance inward from the opening, as a smooth chain of arcs and lines.

A profile starts on the plane sheet (z = 0, horizontal) and ends on a floor (horizontal). Wall angles are taken from
the horizontal, downwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.types import Array

from isf_planner.part_library.arc_chain import ArcChain, chain_of

_STEEPEST = np.radians(89.0)


@dataclass(frozen=True)
class WallProfile:
    """Height z over the inward distance d, both m.

    Attributes
    ----------
    chain : in the plane (d, z), from the flange to the floor
    first, last : m, d where the profile leaves the flange and reaches the floor
    depth : m, of the floor below the flange, positive
    """

    chain: ArcChain
    first: float
    last: float
    depth: float

    def height(self, d: Array) -> tuple[Array, Array]:
        """z (N,) m and dz/dd (N,) at ``d`` (N,) m; flange and floor beyond both ends."""
        inside = np.clip(d, self.first, self.last)
        edges = np.append(self.chain.start[:, 0], self.last)
        k = np.clip(np.searchsorted(edges, inside, side="right") - 1, 0, len(self.chain.length) - 1)
        curvature, heading = self.chain.curvature[k], self.chain.heading[k]
        run = inside - self.chain.start[k, 0]
        straight = run * np.tan(heading)
        safe = np.where(curvature == 0.0, 1.0, curvature)
        turned = np.where(curvature == 0.0, heading, np.arcsin(np.clip(np.sin(heading) + curvature * run, -1, 1)))
        arc = (np.cos(heading) - np.cos(turned)) / safe
        z = self.chain.start[k, 1] + np.where(curvature == 0.0, straight, arc)
        return z, np.where((d < self.first) | (d > self.last), 0.0, np.tan(turned))


def wall(angles: Sequence[float], radii: Sequence[float], lengths: Sequence[float], first: float) -> WallProfile:
    """Profile that turns to each of ``angles`` (rad) with the radius before it, runs its length, and turns flat.

    Parameters
    ----------
    angles : rad, M straight walls from the flange down
    radii : m, M + 1 fillets: entry, between the walls, floor
    lengths : m, M straight lengths
    first : m, d where the entry fillet begins

    Raises
    ------
    ValueError : a wall steeper than 89 deg, a negative length, or a profile that does not go down
    """
    if len(radii) != len(angles) + 1 or len(lengths) != len(angles):
        raise ValueError("needs one radius more than angles, and as many lengths")
    if min(lengths) < 0.0 or max(angles) > _STEEPEST or min(angles) <= 0.0:
        raise ValueError("walls must be 0 to 89 deg steep with lengths of 0 m or more: is the part too shallow?")
    pieces: list[tuple[float, float]] = []
    before = 0.0
    for angle, radius, length in zip([*angles, 0.0], radii, [*lengths, 0.0], strict=True):
        turn = before - angle  # downwards is a turn to the right
        pieces += [(float(np.sign(turn)) / radius, abs(turn) * radius), (0.0, length)]
        before = angle
    chain = chain_of([first, 0.0], 0.0, pieces)
    end = chain.at(np.array([len(chain.length) - 1]), chain.length[-1:])[0][0]
    return WallProfile(chain, first, float(end[0]), float(-end[1]))


def straight_wall(angle: float, depth: float, entry: float, floor: float) -> WallProfile:
    """One straight wall of ``angle`` rad to ``depth`` m; the extended wall meets z = 0 at d = 0."""
    length = (depth - (entry + floor) * (1.0 - np.cos(angle))) / np.sin(angle)
    return wall([angle], [entry, floor], [length], -entry * np.tan(angle / 2))


def curved_wall(first_angle: float, last_angle: float, depth: float, entry: float, floor: float) -> WallProfile:
    """A wall whose angle (rad) changes from the first to the last on one arc, to ``depth`` m; starts at d = 0."""
    drop = depth - entry * (1.0 - np.cos(first_angle)) - floor * (1.0 - np.cos(last_angle))
    radius = drop / abs(np.cos(last_angle) - np.cos(first_angle))
    return wall([first_angle, last_angle], [entry, radius, floor], [0.0, 0.0], 0.0)
