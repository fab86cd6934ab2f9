"""How far each feature follows a morph (Behera 2015, Multi-step mesh morphing, rules for features).

=====  ==============================================================================================
rule   what is done
=====  ==============================================================================================
1      the flange does not distort and is not morphed: its nodes are fixed
2      a plane with another feature below it, joined by a transition rib, is morphed together with both
3      floors are never fixed: they bulge with what is around them, which spreads material
4      flat walls and walls of negative curvature take more steps than steep ones
5      a rib takes at least as many steps as what it lies between, and a strip beside it takes its
=====  ==============================================================================================

The source prints the trend of rule 4 and no formula. Ours: N = N_min + (N_max - N_min) max(1 - alpha / alpha_fail,
min(1, kappa / kappa_ref)), rounded, with the wall angle alpha, the negative curvature kappa and kappa_ref = 1 / R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices, Mask
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from isf_planner.features.surface_features import FeatureMap, Kind, SurfaceFeature

FEWEST, MOST = 2, 4
"""Steps of the feature that moves least and of the one that moves most."""

ON_FLANGE = 20e-6
"""m; what lies no deeper is flange, also where the rim as a feature begins."""

RIB_STRIP = 2
"""Nodes beside a rib that move with it."""


@dataclass(frozen=True)
class MorphRules:
    """Which nodes of a grid move, and how far.

    Attributes
    ----------
    fixed : (ny, nx) nodes of the flange
    steps : (ny, nx) number of steps of every node, from :data:`FEWEST` to :data:`MOST`
    """

    fixed: Mask
    steps: Indices

    @property
    def speed(self) -> Array:
        """(ny, nx) how far a node diffuses, over that of the one that moves most."""
        return self.steps / float(MOST)


def steps_of(wall_angle: float, curvature: float, failure_angle: float, radius: float) -> int:
    """Rule 4: steps of a feature of ``wall_angle`` rad and mean ``curvature`` 1/m (positive: concave from above)."""
    flat = 1.0 - wall_angle / failure_angle
    hollow = min(1.0, max(0.0, -curvature) * radius)
    return FEWEST + round((MOST - FEWEST) * min(1.0, max(0.0, flat, hollow)))


def rules_of(found: FeatureMap, part: HeightMap, failure_angle: float, radius: float) -> MorphRules:
    """Rules on the grid of the ``part`` whose features are ``found``; its sheet fails at ``failure_angle`` rad.

    ``radius`` of the tool, m.
    """
    features = found.features
    steps = np.array([steps_of(f.wall_angle, f.curvature, failure_angle, radius) for f in features])
    for group in _together(features):
        steps[group] = steps[group].max()
    for feature in features:
        if feature.kind.rib:
            between = [k for k in feature.neighbours if features[k].kind.wall or features[k].kind is Kind.FLOOR]
            steps[feature.number] = max(steps[[feature.number, *between]])
    top = np.array([feature.kind is Kind.TOP for feature in features])
    ribs = np.array([feature.kind.rib for feature in features])
    label = found.of_points(part.points()).reshape(part.z.shape)
    by_node = steps[label]
    strips = np.where(ribs[label], by_node, 0)
    by_node = np.maximum(by_node, ndimage.maximum_filter(strips, 2 * RIB_STRIP + 1))
    fixed = top[label] | (part.z > -ON_FLANGE)
    return MorphRules(fixed, by_node)


def _together(features: tuple[SurfaceFeature, ...]) -> list[Indices]:
    """Rule 2: features that a transition rib joins, with the rib."""
    joined = [
        (rib.number, other)
        for rib in features
        if rib.kind is Kind.RIB_TRANSITION
        for other in (*rib.above, *rib.below)
        if features[other].kind.wall
    ]
    if not joined:
        return []
    pairs = np.array(joined)
    count = len(features)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label)
    return [np.flatnonzero(label == k) for k in np.flatnonzero(size > 1)]
