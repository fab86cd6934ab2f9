"""Segmentation of a part into features (Behera 2015, Multi-step mesh morphing and Intelligent sequencing).

The source delegates this step; what stands here is our own, built so that it does not depend on the facets:

1. The surface is sampled on a regular grid (:data:`PITCH`), and its curvature found over a short length. Nodes that
   bend more than a radius of two tool radii are ribs (edges and tight fillets); strips along an edge already from four
   on.
2. The rest is looked at again over a longer length, without what lies beyond a rib: neither principal curvature
   (plane), one (ruled) or both (freeform), positive or negative. Pieces too small to be a feature join what they
   border on.
3. A rib is cut into the ribs between two regions each: along the line as far from one as from the other, if that line
   is longer than the tool's radius. What it is called follows from the two regions and how they lie.
4. Two features that touch are beside each other when their ranges of depth overlap by more than half of the smaller
   one; else one is above the other.

Limits: a wall must be a few nodes wide seen from above. Planes that meet at less than :data:`SMALLEST_EDGE` count as
one.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices, Mask
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from isf_planner.features.curvature import Curvature, curvature
from isf_planner.features.surface_features import FeatureMap, Kind, SurfaceFeature
from isf_planner.forming.sides import flange_level
from isf_planner.part.meshes import Mesh
from isf_planner.surface import height_grid

PITCH = 0.125
"""Of the grid, over the tool radius."""

LARGEST_GRID = 320
"""Most cells of the grid along one side."""

RIB_LENGTH = 0.2
"""Length over which ribs are looked for, over the tool radius."""

RIB_RADIUS = 2.0
"""Radius below which a fillet is a rib, over the tool radius."""

WALL_LENGTH = 0.6
"""Length over which the regions between the ribs are looked at, over the tool radius."""

TURN = 0.2
"""rad; a region whose normals turn less from side to side is a plane."""

CURVED_SHARE = 0.35
"""A node is curved from this share of the middle curvature of the curved nodes of its region on: the border between
the plane and a curved surface beside it, both of which the mean over a length has spread."""

SECOND_SHARE = 0.25
"""A second curvature below this share of the larger one is none: the surface is ruled."""

SMALLEST_SIZE = 2.0
"""Side of the smallest feature, over the tool radius."""

WIDE_RIB_RADIUS = 4.0
"""Radius, over the tool's, of a fillet that is a rib as well where it is a strip along an edge: between flat walls the
radius of a rib is larger than it looks from above."""

WIDEST_RIB = 2.5
"""Width of such a strip, over the tool radius."""

STRIP_LENGTH = 2.0
"""A strip is at least this many times as long as wide."""

ALONG = 0.85
"""Mean cosine between a strip and the direction in which it does not bend."""

FEWEST_NODES = 20
"""Nodes of the smallest strip."""

NARROWEST = 0.6
"""Mean width of the narrowest feature, over the tool radius."""

RIB_ENDS = 0.5
"""How far the ends of a fillet reach beyond what bends enough, over the tool radius."""

LEVEL = np.radians(2.5)
"""rad; a region inclined by less is horizontal."""

LEVEL_RULINGS = np.radians(10.0)
"""rad; rulings inclined by less in the mean are horizontal."""

EVEN = np.radians(5.0)
"""rad; a plane's normals are spread by less (root mean square)."""

ON_FLANGE = 0.3e-3
"""m; a level region this close to the flange is flange."""

SIDE_BY_SIDE = 0.5
"""Share of the smaller range of depth that two features have in common when they lie beside each other."""

SMALLEST_RANGE = 1e-3
"""m; the range of depth of a feature counts as at least this, so that an uneven floor is not beside its rib."""

TOUCHING = 0.5
"""Common border of neighbours, over the tool radius; less is the touch of two corners."""


def find_features(mesh: Mesh, radius: float) -> FeatureMap:
    """Features of ``mesh`` (m, a height field seen from above) for a tool of ``radius`` m."""
    flange = flange_level(mesh)
    size = float(np.ptp(mesh.vertices[:, :2], axis=0).max())
    pitch = max(PITCH * radius, size / LARGEST_GRID)
    level = float(mesh.vertices[:, 2].max()) if flange is None else flange
    return segment(height_grid.sample(mesh, pitch, level, margin=radius), radius)


def segment(heights: HeightMap, radius: float) -> FeatureMap:
    """Features of a surface on a grid whose border is flange, for a tool of ``radius`` m."""
    pitch = height_grid.pitch_of(heights)
    near = curvature(heights, max(RIB_LENGTH * radius, 1.5 * pitch))
    smallest = (SMALLEST_SIZE * radius) ** 2
    bent = np.abs(near.largest).reshape(heights.z.shape) * RIB_RADIUS * radius
    rib = _without_specks(bent > 1.0, near.area.reshape(bent.shape), 0.25 * smallest)
    # a mean over a length lowers the ends of a fillet: what bends half as much beside a rib belongs to it
    ends, square = max(1, round(RIB_ENDS * radius / pitch)), np.ones((3, 3))
    rib = ndimage.binary_dilation(rib, square, ends, mask=rib | (bent > 0.5))
    wide = bent * WIDE_RIB_RADIUS / RIB_RADIUS > 1.0
    strips = _strips(heights, near, wide & ~ndimage.binary_dilation(rib, square, ends), WIDEST_RIB * radius)
    rib |= ndimage.binary_dilation(strips, square, ends + 1, mask=wide)
    far = curvature(heights, max(WALL_LENGTH * radius, 2.0 * pitch), ~rib)
    rib |= far.area.reshape(rib.shape) == 0.0  # single nodes between ribs, with no facet of their own
    region, bends = _regions(far, rib, radius)
    found = _Measures(heights, near, far)
    features = [found.region(number, region, int(bends[number])) for number in range(len(bends))]
    label, borders = _cut_ribs(heights, region, near.area, radius)
    for number, (first, second) in enumerate(borders, start=len(features)):
        features.append(found.rib(number, label, features[first], features[second]))
    return FeatureMap(heights, label, _related(label, features, np.sqrt(near.area).reshape(label.shape), radius))


def _without_specks(mask: Mask, area: Array, smallest: float) -> Mask:
    """``mask`` without its pieces, and without gaps, of less than ``smallest`` m^2."""
    for value in (True, False):
        pieces, count = ndimage.label(mask == value)
        size = ndimage.sum_labels(area, pieces, np.arange(count + 1))
        size[0] = np.inf
        mask = np.where(size[pieces] < smallest, not value, mask)
    return mask


PLAIN, SINGLE, DOUBLE = 0, 1, 2
"""How many principal curvatures there are; negative where the mean curvature is."""


def _regions(far: Curvature, rib: Mask, radius: float) -> tuple[Indices, Indices]:
    """(ny, nx) connected regions that bend alike, from 0, -1 on ribs; and how each of them bends."""
    smallest = (SMALLEST_SIZE * radius) ** 2
    area = far.area.reshape(rib.shape)
    larger, second = far.largest.reshape(rib.shape), far.second.reshape(rib.shape)
    pieces, _ = ndimage.label(~rib)
    bend = np.zeros(rib.shape, dtype=np.int64)
    for number, window in enumerate(ndimage.find_objects(pieces), start=1):
        mine = pieces[window] == number
        size, k1, k2 = np.abs(larger[window]), larger[window], second[window]
        threshold = TURN / np.sqrt(max(area[window][mine].sum(), smallest))
        curved = size[mine & (size > threshold)]
        if len(curved):
            threshold = max(threshold, CURVED_SHARE * float(np.median(curved)))
        doubly = np.abs(k2) > np.maximum(SECOND_SHARE * size, threshold)
        count = np.where(size <= threshold, PLAIN, np.where(doubly, DOUBLE, SINGLE))
        bend[window][mine] = np.where(k1 + k2 >= 0, count, -count)[mine]
    region = _merged(bend, rib, area, smallest, NARROWEST * radius)
    values = np.arange(-DOUBLE, DOUBLE + 1)
    inside = region >= 0
    share = [np.bincount(region[inside], (area * (bend == value))[inside]) for value in values]
    return region, values[np.argmax(share, axis=0)]


def _merged(bend: Indices, rib: Mask, area: Array, smallest: float, narrowest: float) -> Indices:
    """Connected regions of one ``bend``; what is too small to be one joins the region it has most border with.

    Too small is less than ``smallest`` m^2, or narrower in the mean than ``narrowest`` m. A narrow one that lies
    between ribs alone is a part of them (-1).
    """
    region = np.full(bend.shape, -1)
    count = 0
    for value in np.unique(bend[~rib]):
        pieces, number = ndimage.label((bend == value) & ~rib)
        region = np.where(pieces > 0, pieces - 1 + count, region)
        count += number
    size = np.bincount(region[~rib], area[~rib], minlength=count)
    around: list[defaultdict[int, float]] = [defaultdict(float) for _ in range(count)]
    for a, b, length in _borders(region, np.sqrt(area)):
        if a >= 0:
            around[a][b] += length
        around[b][a] += length

    def unfit(k: int) -> bool:
        return bool(size[k] < smallest or 2.0 * size[k] < narrowest * sum(around[k].values()))

    waiting = [(float(size[k]), k) for k in range(count) if unfit(k)]
    heapq.heapify(waiting)
    into = np.arange(count)
    while waiting:
        known, least = heapq.heappop(waiting)
        if into[least] != least or known != size[least]:
            continue
        beside = {k: length for k, length in around[least].items() if k >= 0}
        if not beside:
            if 2.0 * size[least] < narrowest * sum(around[least].values()):
                into[least] = -1
            continue
        other = max(beside, key=lambda k: beside[k])
        into[least] = other
        size[other] += size[least]
        around[other][-1] += around[least][-1]
        for neighbour, length in beside.items():
            del around[neighbour][least]
            if neighbour != other:
                around[neighbour][other] += length
                around[other][neighbour] += length
        if unfit(other):
            heapq.heappush(waiting, (float(size[other]), int(other)))
    while ((into >= 0) & (into[into] != into)).any():
        into = np.where(into >= 0, into[into], -1)
    known_regions, dense = np.unique(into, return_inverse=True)
    return np.where(rib, -1, (dense - int(known_regions[0] < 0))[region])


def _strips(heights: HeightMap, near: Curvature, candidates: Mask, widest: float) -> Mask:
    """Those pieces of the ``candidates`` that are strips of up to ``widest`` m along an edge: fillets of flat edges."""
    pieces, count = ndimage.label(candidates)
    flat, points = pieces.ravel(), heights.points()
    found = np.zeros(count + 1, dtype=np.bool_)
    for number in range(1, count + 1):
        on = np.flatnonzero(flat == number)
        weight = near.area[on]
        if len(on) < FEWEST_NODES:
            continue
        apart = points[on] - np.average(points[on], axis=0, weights=weight)
        # the variance along a strip is a twelfth of its squared length
        variance, axes = np.linalg.eigh((apart * weight[:, None]).T @ apart / weight.sum())
        length = float(np.sqrt(12.0 * variance[2]))
        width = float(weight.sum()) / length
        along = np.average(np.abs(near.ridge[on] @ axes[:, 2]), weights=weight)
        found[number] = width < widest and length > STRIP_LENGTH * width and along > ALONG
    return found[pieces]


def _ends(values: NDArray[Any]) -> tuple[tuple[NDArray[Any], NDArray[Any]], ...]:
    """What stands at both ends of every edge of the grid: along x, along y, and the diagonal of the facets."""
    return (
        (values[:, :-1].ravel(), values[:, 1:].ravel()),
        (values[:-1].ravel(), values[1:].ravel()),
        (values[:-1, :-1].ravel(), values[1:, 1:].ravel()),
    )


def _borders(label: Indices, size: Array) -> list[tuple[int, int, float]]:
    """Pairs of different labels, the lower first, and the length of their border; ``size`` (ny, nx) m of the nodes."""
    ends = np.hstack([np.sort([a, b], axis=0) for a, b in _ends(label)[:2]])
    length = np.concatenate([0.5 * (a + b) for a, b in _ends(size)[:2]])
    apart = ends[0] != ends[1]
    pairs, which = np.unique(ends[:, apart], axis=1, return_inverse=True)
    total = np.bincount(which.ravel(), length[apart], pairs.shape[1])
    return [(int(a), int(b), float(n)) for a, b, n in zip(*pairs, total, strict=True)]


def _cut_ribs(heights: HeightMap, region: Indices, area: Array, radius: float) -> tuple[Indices, list[tuple[int, int]]]:
    """``region`` with the ribs labelled behind the regions, and the two regions that each rib lies between.

    A rib that has one region only around it lies between that and itself.
    """
    rib = (region < 0).ravel()
    flat = region.ravel().copy()
    first = int(flat.max()) + 1
    if not rib.any():
        return region, []
    node = np.arange(rib.size).reshape(region.shape)
    ends = np.hstack([np.array(pair) for pair in _ends(node)])
    ends = ends[:, rib[ends].any(axis=0)]
    points = heights.points()
    length = np.linalg.norm(points[ends[0]] - points[ends[1]], axis=1)
    graph = coo_matrix((length, (ends[0], ends[1])), shape=(rib.size, rib.size)).tocsr()
    nearest = _spread(graph, np.unique(ends[~rib[ends]]), flat)
    sides = np.sort(nearest[ends], axis=0)
    apart = (sides[0] != sides[1]) & (sides[0] >= 0)
    line = np.full(rib.size, -1)
    borders: list[tuple[int, int]] = []
    for pair in np.unique(sides[:, apart], axis=1).T:
        middle = ends[:, apart & (sides == pair[:, None]).all(axis=0)]
        mask = np.zeros(rib.size, dtype=np.bool_)
        mask[middle[rib[middle]]] = True
        pieces, count = ndimage.label(mask.reshape(region.shape), np.ones((3, 3)))
        for k in range(1, count + 1):
            on = np.flatnonzero(pieces.ravel() == k)
            if 0.5 * np.sqrt(area[on]).sum() >= radius:  # a line passes between two rows of nodes
                line[on] = first + len(borders)
                borders.append((int(pair[0]), int(pair[1])))
    within = rib[ends].all(axis=0)
    inner = coo_matrix((length[within], (ends[0, within], ends[1, within])), shape=(rib.size, rib.size)).tocsr()
    cut = _spread(inner, np.flatnonzero(line >= 0), line)
    flat[rib] = cut[rib]
    rest, count = ndimage.label((flat < 0).reshape(region.shape))
    for k in range(1, count + 1):
        on = np.flatnonzero(rest.ravel() == k)
        around = nearest[on]
        around = around[around >= 0]
        own = int(np.bincount(around).argmax()) if len(around) else 0
        flat[on] = first + len(borders)
        borders.append((own, own))
    return flat.reshape(region.shape), borders


def _spread(graph: csr_matrix, sources: Indices, value: Indices) -> Indices:
    """(N,) ``value`` (N,) of the nearest of ``sources`` along the edges of ``graph``; -1 where none leads."""
    if len(sources) == 0:
        return np.full(len(value), -1)
    _, _, source = dijkstra(graph, directed=False, indices=sources, min_only=True, return_predecessors=True)
    return np.where(source >= 0, value[np.maximum(source, 0)], -1)


@dataclass(frozen=True)
class _Measures:
    """What is known of every node, from which features are measured: ``near`` on ribs, ``far`` elsewhere."""

    heights: HeightMap
    near: Curvature
    far: Curvature

    def region(self, number: int, region: Indices, bend: int) -> SurfaceFeature:
        """The feature that region ``number`` is."""
        feature = self._measured(number, region, self.far)
        on = region.ravel() == number
        weight = self.far.area[on]
        normal = np.average(self.far.normal[on], axis=0, weights=weight)
        spread = np.sqrt(np.average(((self.far.normal[on] - normal) ** 2).sum(axis=1), weights=weight))
        if bend == PLAIN and spread > EVEN:
            bend = SINGLE if feature.curvature >= 0 else -SINGLE
        if bend == PLAIN:
            return replace(feature, kind=self._plane(feature, normal))
        level = np.average(np.abs(self.far.ridge[on, 2]), weights=weight) < np.sin(LEVEL_RULINGS)
        return replace(feature, kind=_BENT[bend], horizontal_rulings=bool(level) and abs(bend) == SINGLE)

    def rib(self, number: int, label: Indices, first: SurfaceFeature, second: SurfaceFeature) -> SurfaceFeature:
        """The rib ``number`` between two regions."""
        feature = self._measured(number, label, self.near)
        kinds = {first.kind, second.kind}
        if Kind.TOP in kinds:
            return replace(feature, kind=Kind.RIM)
        if Kind.FLOOR in kinds:
            return replace(feature, kind=Kind.RIB_BOTTOM)
        if first.number == second.number:
            upright = self._runs_down(label.ravel() == number)
        else:
            upright = _overlap(first, second) > SIDE_BY_SIDE
        return replace(feature, kind=Kind.RIB_SEMI_VERTICAL if upright else Kind.RIB_TRANSITION)

    def _measured(self, number: int, label: Indices, values: Curvature) -> SurfaceFeature:
        on = np.flatnonzero(label.ravel() == number)
        points, weight = self.heights.points()[on], np.maximum(values.area[on], 1e-15)
        middle = np.average(points, axis=0, weights=weight)
        lowest, highest = np.quantile(points[:, 2], [0.01, 0.99])
        angle = np.arccos(np.clip(values.normal[on, 2], 0.0, 1.0))
        return SurfaceFeature(
            number=number,
            kind=Kind.PLANE,
            wall_angle=float(np.average(angle, weights=weight)),
            curvature=float(np.average(values.largest[on], weights=weight)),
            area=float(weight.sum()),
            lowest=float(lowest),
            highest=float(highest),
            place=points[np.argmin(((points - middle) ** 2).sum(axis=1))],
        )

    def _plane(self, feature: SurfaceFeature, normal: Array) -> Kind:
        if np.arccos(np.clip(normal[2] / np.linalg.norm(normal), -1.0, 1.0)) > LEVEL:
            return Kind.PLANE
        z = self.heights.z
        flange = float(np.median(np.concatenate([z[0], z[-1], z[:, 0], z[:, -1]])))
        return Kind.TOP if abs(feature.highest - flange) < ON_FLANGE else Kind.FLOOR

    def _runs_down(self, on: Mask) -> bool:
        """Along the nodes ``on`` the edge runs down the slope rather than along a level."""
        slope = self.near.normal[on, :2]
        along = np.abs((self.near.ridge[on, :2] * slope).sum(axis=1))
        across = np.abs(self.near.ridge[on, 0] * slope[:, 1] - self.near.ridge[on, 1] * slope[:, 0])
        return bool(along.sum() > across.sum())


_BENT = {
    SINGLE: Kind.RULED_POSITIVE,
    -SINGLE: Kind.RULED_NEGATIVE,
    DOUBLE: Kind.FREEFORM_POSITIVE,
    -DOUBLE: Kind.FREEFORM_NEGATIVE,
}


def _overlap(first: SurfaceFeature, second: SurfaceFeature, smallest: float = 1e-9) -> float:
    """Depth that two features have in common, over the smaller one of their ranges (m, at least ``smallest``)."""
    common = min(first.highest, second.highest) - max(first.lowest, second.lowest)
    range_ = min(first.highest - first.lowest, second.highest - second.lowest)
    return common / max(range_, smallest)


def _related(label: Indices, features: list[SurfaceFeature], size: Array, radius: float) -> tuple[SurfaceFeature, ...]:
    """The features with their neighbours; ``size`` (ny, nx) m of the nodes, ``radius`` m of the tool."""
    beside: list[list[int]] = [[] for _ in features]
    above: list[list[int]] = [[] for _ in features]
    below: list[list[int]] = [[] for _ in features]
    for a, b, length in _borders(label, size):
        if length < TOUCHING * radius:
            continue
        first, second = features[a], features[b]
        if _overlap(first, second, SMALLEST_RANGE) > SIDE_BY_SIDE:
            beside[a].append(b)
            beside[b].append(a)
            continue
        upper, lower = (a, b) if first.highest + first.lowest > second.highest + second.lowest else (b, a)
        below[upper].append(lower)
        above[lower].append(upper)
    return tuple(
        replace(feature, beside=tuple(beside[k]), above=tuple(above[k]), below=tuple(below[k]))
        for k, feature in enumerate(features)
    )
