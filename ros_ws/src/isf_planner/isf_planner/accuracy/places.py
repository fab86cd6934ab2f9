"""What the deviation of a formed part may depend on, at every place of its target.

The predictors are those of the published maps (Behera 2015, introduction): the kind of feature, wall
angle, curvature, distances to rim and floor along the wall, thickness, orientation, and what lies above, below and
beside. All are found on the target over a grid, the same for a part that was formed and for one that is planned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices, Mask
from scipy import ndimage
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from isf_planner.features.curvature import curvature
from isf_planner.features.segmentation import ON_FLANGE, WALL_LENGTH, segment
from isf_planner.features.surface_features import FeatureMap, Kind, SurfaceFeature
from isf_planner.surface import height_grid

NUMBERS = (
    "wall angle [rad]",
    "larger curvature times the tool radius",
    "smaller curvature times the tool radius",
    "depth [m]",
    "distance to the rim along the wall [m]",
    "distance to the floor along the wall, negative on it [m]",
    "distance to a rib that runs down [m]",
    "blank thickness [m]",
    "sine-law thickness [m]",
    "x of the normal",
    "y of the normal",
    "x^2 - y^2 of the normal",
    "2 x y of the normal",
    "wall angle above less own [rad]",
    "wall angle below less own [rad]",
    "depth of the part [m]",
    "largest distance from the outline in the opening [m]",
)
"""Predictors that are numbers."""

KINDS = (
    Kind.FLOOR,
    Kind.PLANE,
    Kind.RULED_POSITIVE,
    Kind.RULED_NEGATIVE,
    Kind.FREEFORM_POSITIVE,
    Kind.FREEFORM_NEGATIVE,
    Kind.RIM,
    Kind.RIB_SEMI_VERTICAL,
    Kind.RIB_TRANSITION,
    Kind.RIB_BOTTOM,
)
"""Kinds of feature, each a predictor of 0 or 1."""

PREDICTORS = (*NUMBERS, *(kind.value for kind in KINDS))

SHARPEST = 1.0
"""Curvatures count up to this times one over the tool radius: at an edge they depend on the grid."""

FARTHEST_RIB = 6.0
"""Tool radii; a rib farther away has no effect (assumed)."""

OPENING_DEPTH = 0.1e-3
"""m below the flange from which a place belongs to the part, as in the report."""

MARGIN = 3
"""Cells of flange that are kept around a part."""


@dataclass(frozen=True)
class Places:
    """The places of a target.

    Attributes
    ----------
    heights : the target around the part, m, flange at z = 0
    formed : (ny, nx) places of the part, without the flange
    values : (ny * nx, P) of :data:`PREDICTORS`, row by row; of flange nodes too
    normal : (ny * nx, 3) unit, upwards
    """

    heights: HeightMap
    formed: Mask
    values: Array
    normal: Array


def find_places(target: HeightMap, radius: float, thickness: float) -> Places | None:
    """Places of ``target`` (m, flange at z = 0) for a tool of ``radius`` m and a blank ``thickness`` m; None: flat."""
    heights = cropped(target)
    if heights is None:
        return None
    found = segment(heights, radius)
    smooth = curvature(heights, max(WALL_LENGTH * radius, 2.0 * height_grid.pitch_of(heights)))
    z, normal = heights.z, smooth.normal
    label = found.label.ravel()
    formed = ndimage.binary_fill_holes(z < -OPENING_DEPTH)
    angle = np.arccos(np.clip(normal[:, 2], 0.0, 1.0))
    graph = _surface_graph(heights)
    is_kind = {
        kind: np.isin(label, [f.number for f in found.features if f.kind is kind]) for kind in (Kind.TOP, *KINDS)
    }
    top = is_kind[Kind.TOP] | ~formed.ravel()
    floor = is_kind[Kind.FLOOR]
    if not floor.any():  # a bowl: its lowest places
        floor = z.ravel() < z.min() + ON_FLANGE
    to_rim = _distance(graph, top)
    to_floor = _distance(graph, floor) - _distance(graph, ~floor)
    upright = is_kind[Kind.RIB_SEMI_VERTICAL]
    farthest = FARTHEST_RIB * radius
    to_rib = np.minimum(_distance(graph, upright), farthest) if upright.any() else np.full(len(label), farthest)
    above, below, own = (values[label] for values in _angles(found))
    width = ndimage.distance_transform_edt(formed, sampling=height_grid.pitch_of(heights))
    count = len(label)
    x, y = normal[:, 0], normal[:, 1]
    numbers = [
        angle,
        np.clip(smooth.largest * radius, -SHARPEST, SHARPEST),
        np.clip(smooth.second * radius, -SHARPEST, SHARPEST),
        -z.ravel(),
        to_rim,
        to_floor,
        to_rib,
        np.full(count, thickness),
        thickness * np.cos(angle),
        x,
        y,
        x * x - y * y,
        2.0 * x * y,
        above - own,
        below - own,
        np.full(count, -z.min()),
        np.full(count, width.max()),
    ]
    values = np.column_stack([*numbers, *(is_kind[kind].astype(float) for kind in KINDS)])
    return Places(heights, formed, values, normal)


def cropped(target: HeightMap) -> HeightMap | None:
    """``target`` around what lies below its flange, with some flange; None when nothing does."""
    rows, columns = np.nonzero(target.z < -OPENING_DEPTH)
    if not len(rows):
        return None
    row = slice(max(rows.min() - MARGIN, 0), rows.max() + MARGIN + 1)
    column = slice(max(columns.min() - MARGIN, 0), columns.max() + MARGIN + 1)
    return HeightMap(target.x[column], target.y[row], target.z[row, column])


_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""Rows and columns to half of the 16 neighbours of a node: ways along them are at most 3 % too long."""


def _surface_graph(heights: HeightMap) -> csr_matrix:
    """Lengths m along the surface between neighbouring nodes."""
    node = np.arange(heights.z.size).reshape(heights.z.shape)
    points = heights.points()
    rows, columns = heights.z.shape
    first, second = [], []
    for down, right in _STEPS:
        a = node[: rows - down, max(0, -right) : columns - max(0, right)]
        b = node[down:, max(0, right) : columns + min(0, right)]
        first.append(a.ravel())
        second.append(b.ravel())
    a, b = np.concatenate(first), np.concatenate(second)
    length = np.linalg.norm(points[a] - points[b], axis=1)
    return coo_matrix((length, (a, b)), shape=(node.size, node.size)).tocsr()


def _distance(graph: csr_matrix, sources: Mask) -> Array:
    """(N,) m along the surface to the nearest of the nodes ``sources``; 0 where there are none."""
    if not sources.any():
        return np.zeros(len(sources))
    found = dijkstra(graph, directed=False, indices=np.flatnonzero(sources), min_only=True)
    return np.where(np.isfinite(found), found, 0.0)


def _angles(found: FeatureMap) -> tuple[Array, Array, Array]:
    """Wall angle (F,) rad of what lies above a feature, below it, and its own; flange and floor are level."""
    features = found.features
    own = np.array([feature.wall_angle for feature in features])

    def beyond(feature: SurfaceFeature, upwards: bool) -> float:
        seen, waiting, reached = {feature.number}, [feature], []
        while waiting:
            one = waiting.pop()
            for number in one.above if upwards else one.below:
                other = features[number]
                if number in seen:
                    continue
                seen.add(number)
                if other.kind.rib:
                    waiting.append(other)
                elif other.kind.wall:
                    reached.append(other)
        area = [other.area for other in reached]
        return float(np.average([other.wall_angle for other in reached], weights=area)) if area else 0.0

    above, below = (np.array([beyond(feature, up) for feature in features]) for up in (True, False))
    return above, below, own


def nodes_of(places: Places) -> Indices:
    """Nodes of the part, by number."""
    return np.flatnonzero(places.formed.ravel())
