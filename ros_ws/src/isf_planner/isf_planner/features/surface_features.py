"""What a surface is made of: its features by kind, where they lie, and how they neighbour each other.

The kinds are those that rules for tool paths and morphing are stated in (Behera 2015, Multi-step mesh morphing):
planes, ruled and freeform surfaces of positive curvature (bowls: the radius points into the cavity) and of negative
one, floor, flange, and ribs, the edges and tight fillets between them. A rib runs down between two walls beside each
other (semi-vertical), between two walls below each other (transition), or around a floor (bottom). Where a wall begins
at the flange is the rim, which the source does not count as a rib.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from enum import Enum

from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices

from isf_planner.surface import height_grid


class Kind(Enum):
    """What a feature is."""

    TOP = "top"
    FLOOR = "floor"
    PLANE = "plane"
    RULED_POSITIVE = "ruled_positive"
    RULED_NEGATIVE = "ruled_negative"
    FREEFORM_POSITIVE = "freeform_positive"
    FREEFORM_NEGATIVE = "freeform_negative"
    RIM = "rim"
    RIB_SEMI_VERTICAL = "rib_semi_vertical"
    RIB_TRANSITION = "rib_transition"
    RIB_BOTTOM = "rib_bottom"

    @property
    def rib(self) -> bool:
        """An edge or a tight fillet, the rim included."""
        return self is Kind.RIM or self.value.startswith("rib")

    @property
    def wall(self) -> bool:
        """What stands inclined between flange and floor, without the ribs."""
        return not self.rib and self not in (Kind.TOP, Kind.FLOOR)

    @property
    def title(self) -> str:
        """For people: "rib, semi-vertical"."""
        return _TITLES.get(self, self.value)


_TITLES = {
    Kind.TOP: "top (flange)",
    Kind.RULED_POSITIVE: "ruled, positive",
    Kind.RULED_NEGATIVE: "ruled, negative",
    Kind.FREEFORM_POSITIVE: "freeform, positive",
    Kind.FREEFORM_NEGATIVE: "freeform, negative",
    Kind.RIB_SEMI_VERTICAL: "rib, semi-vertical",
    Kind.RIB_TRANSITION: "rib, transition",
    Kind.RIB_BOTTOM: "rib, bottom",
}


@dataclass(frozen=True)
class SurfaceFeature:
    """One feature; lengths m, angles rad.

    Attributes
    ----------
    number : index in :attr:`FeatureMap.features`, and its label
    kind : what it is
    wall_angle : mean from the horizontal, by area
    curvature : 1/m, mean of the larger principal curvature by area, positive where concave from above
    area : m^2
    lowest, highest : m, z without the outermost hundredth of its area
    place : (3,) m, a point of it near its middle
    horizontal_rulings : ruled kinds: the straight lines are level, so that the wall angle changes with depth
    beside, above, below : numbers of neighbouring features at the same depth, above it and below it
    """

    number: int
    kind: Kind
    wall_angle: float
    curvature: float
    area: float
    lowest: float
    highest: float
    place: Array
    horizontal_rulings: bool = False
    beside: tuple[int, ...] = ()
    above: tuple[int, ...] = ()
    below: tuple[int, ...] = ()

    @property
    def neighbours(self) -> tuple[int, ...]:
        """Of all three sorts."""
        return tuple(sorted((*self.beside, *self.above, *self.below)))


@dataclass(frozen=True)
class FeatureMap:
    """A surface with its features.

    Attributes
    ----------
    heights : the surface on a regular grid, m
    label : (ny, nx) number of the feature of every node
    features : by number
    """

    heights: HeightMap
    label: Indices
    features: tuple[SurfaceFeature, ...]

    def counts(self) -> dict[str, int]:
        """How many features there are of every kind that occurs, in the order of :class:`Kind`."""
        found = Counter(feature.kind for feature in self.features)
        return {kind.value: found[kind] for kind in Kind if found[kind]}

    def of_points(self, points: Array) -> Indices:
        """(N,) feature of points (N, 2) or (N, 3) m, such as the middles of facets; the nearest beyond the grid."""
        return self.label[height_grid.nearest_node(self.heights, points)]

    def horizontal_rank(self, first: int, second: int) -> int | None:
        """Which horizontal neighbour ``second`` is of ``first``: 1 beside it, 2 beside that one; None: it is none."""
        rank = {first: 0}
        waiting = deque([first])
        while waiting:
            number = waiting.popleft()
            for other in self.features[number].beside:
                if other not in rank:
                    rank[other] = rank[number] + 1
                    waiting.append(other)
        return rank.get(second)
