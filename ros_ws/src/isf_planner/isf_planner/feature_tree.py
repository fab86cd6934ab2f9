"""Which loop belongs to which feature: the tree of pockets and islands over all levels.

The places below a level lie within the places below the level above it. So every pocket loop has exactly one
pocket loop above it, its parent, and pockets only ever split on the way down. A feature is a chain of loops from
where it appears to where it splits or ends; the features a pocket splits into are its children. Around an island the
tip must stay outside, and islands only ever grow and merge on the way down: where two merge, the one with the longer
loop goes on. An island is a child of the pocket it stands in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from isf_planner.tip_loops import TipLoop

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Feature:
    """A chain of loops that follow each other downwards (of a lower tool: upwards).

    Attributes
    ----------
    number : index in ``LoopTree.features``; parents come before their children
    parent : number of the feature it grows out of or stands in, -1 at the top
    island : True for the loops around an island
    forming_tool : 1 (upper) or 2 (lower: the feature rises above the blank)
    loops : indices into ``LoopTree.loops``, from the flange away
    """

    number: int
    parent: int
    island: bool
    forming_tool: int
    loops: tuple[int, ...]


@dataclass(frozen=True)
class LoopTree:
    """All loops of a part, and the features they belong to.

    ``loops`` stand feature by feature in the plain order of forming: parents before children, out to in.
    """

    loops: tuple[TipLoop, ...]
    features: tuple[Feature, ...]

    def children(self, number: int) -> tuple[Feature, ...]:
        """Features that grow out of feature ``number`` or stand in it; -1 for those at the top."""
        return tuple(feature for feature in self.features if feature.parent == number)


@dataclass(frozen=True)
class RoughLoop:
    """A level line before it is settled.

    Attributes
    ----------
    level : m ; points : (K, 2) m ; island : goes around higher ground
    above : indices of the loops higher up that it continues (pocket: its one parent; island: all islands it has
        swallowed, the longest first)
    pocket : index of the loop of the pocket an island stands in, -1 for a pocket
    real : False for the border of what is formed at all, which is no contour
    """

    level: float
    points: Array
    island: bool
    above: tuple[int, ...] = ()
    pocket: int = -1
    real: bool = True

    @property
    def polygon(self) -> shapely.Polygon:
        """Everything inside the loop, m."""
        return shapely.Polygon(self.points)


def link(nodes: list[RoughLoop], loops: Sequence[RoughLoop], before: Sequence[int]) -> list[int]:
    """Append the loops of one level to ``nodes``, linked to the nodes ``before`` (indices); their indices."""
    previous = {k: nodes[k].polygon for k in before}
    added: list[int] = []
    for loop in sorted(loops, key=lambda loop: loop.island):  # a pocket before the islands that stand in it
        if loop.island:
            shape = loop.polygon
            inside = [k for k in before if nodes[k].island and within(nodes[k].points, shape)]
            above = tuple(sorted(inside, key=lambda k: -previous[k].length))
            around = [k for k in added if not nodes[k].island and within(loop.points, nodes[k].polygon)]
            pocket = min(around, key=lambda k: nodes[k].polygon.area, default=-1)
        else:
            around = [k for k in before if not nodes[k].island and within(loop.points, previous[k])]
            above, pocket = (min(around, key=lambda k: previous[k].area),) if around else (), -1
        added.append(len(nodes))
        nodes.append(replace(loop, above=above, pocket=pocket))
    return added


def chains(nodes: Sequence[RoughLoop]) -> tuple[list[list[int]], list[int]]:
    """Features as chains of indices of ``nodes``, parents before children, and the parent of each (-1: none)."""
    heirs = np.bincount([loop.above[0] for loop in nodes if loop.above], minlength=len(nodes))
    found: list[list[int]] = []
    parents: list[int] = []
    owner: list[int] = []
    for k, loop in enumerate(nodes):
        upper = owner[loop.above[0]] if loop.above else -1
        if loop.above and heirs[loop.above[0]] == 1:
            owner.append(upper)
            found[upper].append(k)
            continue
        owner.append(len(found))
        found.append([k])
        parents.append(owner[loop.pocket] if loop.pocket >= 0 else upper)
    return _depth_first([[k for k in chain if nodes[k].real] for chain in found], parents)


def _depth_first(found: list[list[int]], parents: list[int]) -> tuple[list[list[int]], list[int]]:
    """Order of forming; chains without a loop leave their place to their children."""
    order: list[int] = []
    waiting = [number for number, parent in enumerate(parents) if parent < 0][::-1]
    while waiting:
        number = waiting.pop()
        order.append(number)
        waiting += [child for child, parent in enumerate(parents) if parent == number][::-1]
    renamed: dict[int, int] = {-1: -1}
    kept: list[int] = []
    for number in order:
        if found[number]:
            renamed[number] = len(kept)
            kept.append(number)
        else:
            renamed[number] = renamed[parents[number]]
    return [found[k] for k in kept], [renamed[parents[k]] for k in kept]


def within(points: Array, shape: shapely.Polygon) -> bool:
    """Most of a few points of a loop are inside: single ones may lie on the border where loops touch."""
    some = points[:: max(1, len(points) // 7)]
    inside = shapely.contains_xy(shape, some[:, 0], some[:, 1])
    return bool(np.count_nonzero(inside) * 2 > len(some))
