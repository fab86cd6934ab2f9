"""Partial tool paths: one for every feature of the surface, and how they join (Behera 2015, Intelligent sequencing).

A level line of the tip runs over several features. What the tool touches cuts it into curves, and the curves of one
feature, from level to level, are its partial tool path. At every level the curves of the features that are formed there
(:mod:`isf_planner.loops.feature_levels`) join again: to a closed contour, or to a pass over some of the features. The
source joins curves from separate files by sorting their points around a centre, which presumes star-shaped contours;
here a curve remembers the line it was cut from, so that any shape keeps its length.

A pass does not end on its last feature: it goes on over the rib there until it is a tool radius into the feature
behind, as its ends are not to lie near ribs. A rest of a level line shorter than two radii is passed over, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array, Indices, Mask
from scipy.spatial import KDTree

from isf_planner.features.surface_features import FeatureMap, Kind
from isf_planner.loops.feature_levels import FeatureLevels
from isf_planner.loops.sections import LoopTree
from isf_planner.loops.tip_loops import TipLoop
from isf_planner.part.mesh_checks import place_text
from isf_planner.surface import tip_surface
from isf_planner.surface.target_surface import TargetSurface

SAFE = 1.0
"""Distance of starts and ends from ribs that run down, over the tool radius."""

SHORTEST_CURVE = 0.25
"""Length of the shortest curve, over the tool radius; less is a touch at a border."""


@dataclass(frozen=True)
class Curve:
    """A piece of a level line on one feature: ``count`` points of ``loop`` from ``begin`` on, around its seam too."""

    feature: int
    loop: int
    begin: int
    count: int


@dataclass(frozen=True)
class Pass:
    """Curves joined: the ``points`` (N,) of ``loop`` in its order; ``closed``: all of them."""

    loop: int
    points: Indices
    closed: bool


@dataclass(frozen=True)
class PartialPaths:
    """The partial paths of one side of a part.

    Attributes
    ----------
    found : features of the surface
    curves : of all partial paths ; passes : what they join to, loop by loop
    rib_distance : for every loop (N,) m, seen from above, from its contacts to the nearest rib that runs down, infinite
        without one
    """

    found: FeatureMap
    curves: tuple[Curve, ...]
    passes: tuple[Pass, ...]
    rib_distance: tuple[Array, ...]

    @property
    def features(self) -> tuple[int, ...]:
        """Numbers of the features that have a partial path."""
        return tuple(sorted({curve.feature for curve in self.curves}))


def partial_paths(tree: LoopTree, found: FeatureMap, levels: FeatureLevels, radius: float) -> PartialPaths:
    """Partial paths along the loops of ``tree`` for a ball of ``radius`` m; the features lie as seen from above."""
    ribs = [feature.number for feature in found.features if feature.kind is Kind.RIB_SEMI_VERTICAL]
    nodes = found.heights.points()[np.isin(found.label.ravel(), ribs), :2]
    near_ribs = KDTree(nodes) if len(nodes) else None
    curves: list[Curve] = []
    passes: list[Pass] = []
    rib_distance: list[Array] = []
    for number, loop in enumerate(tree.loops):
        contact = loop.contact(radius)
        away = near_ribs.query(contact[:, :2])[0] if near_ribs else np.full(len(contact), np.inf)
        rib_distance.append(away)
        spacing = _spacing(loop)
        label = _without_touches(found.of_points(contact), max(1, round(SHORTEST_CURVE * radius / spacing)))
        formed = _with_walls(levels.at(loop.level)[label], np.isin(label, ribs))
        taken = _extended(formed, away < SAFE * radius, max(2, round(SAFE * radius / spacing)))
        curves += [Curve(int(label[begin]), number, begin, count) for begin, count in runs(label) if formed[begin]]
        if taken.all():
            passes.append(Pass(number, np.arange(len(taken)), True))
            continue
        passes += [
            Pass(number, np.mod(np.arange(begin, begin + count), len(taken)), False)
            for begin, count in runs(taken)
            if taken[begin]
        ]
    return PartialPaths(found, tuple(curves), tuple(passes), tuple(rib_distance))


def runs(values: Indices | Mask) -> list[tuple[int, int]]:
    """Begin and count of the runs of equal ``values`` (N,) around a ring; one run begins at 0 where all are equal."""
    changes = np.flatnonzero(values != np.roll(values, 1))
    if len(changes) == 0:
        return [(0, len(values))]
    counts = np.diff(np.append(changes, changes[0] + len(values)))
    return list(zip(changes.tolist(), counts.tolist(), strict=True))


def _spacing(loop: TipLoop) -> float:
    return float(np.linalg.norm(np.roll(loop.points, -1, axis=0) - loop.points, axis=1).mean())


def _without_touches(label: Indices, shortest: int) -> Indices:
    """``label`` (N,) around a ring, runs of less than ``shortest`` points joined to the longer one beside."""
    label = label.copy()
    while True:
        found = runs(label)
        least = min(range(len(found)), key=lambda k: found[k][1])
        begin, count = found[least]
        if len(found) == 1 or count >= shortest:
            return label
        before, after = found[least - 1], found[(least + 1) % len(found)]
        into = before if before[1] >= after[1] else after
        label[np.mod(np.arange(begin, begin + count), len(label))] = label[into[0]]


def _with_walls(formed: Mask, rib: Mask) -> Mask:
    """``formed`` (N,) around a ring without pieces that are ``rib`` alone: ribs are formed with the walls beside."""
    kept = formed.copy()
    for begin, count in runs(formed):
        part = np.mod(np.arange(begin, begin + count), len(formed))
        if count < len(formed) and rib[part].all():
            kept[part] = False
    return kept


def _extended(formed: Mask, near_rib: Mask, reach: int) -> Mask:
    """Points ``formed`` (N,) around a ring, each end ``reach`` points and then on until it is not ``near_rib``."""
    taken = formed.copy()
    n = len(taken)
    for begin, count in runs(formed):
        if not formed[begin] or count == n:
            continue
        for end, way in ((begin - 1, -1), (begin + count, 1)):
            for k in range(n):
                taken[(end + k * way) % n] = True
                if k >= reach and not near_rib[(end + k * way) % n]:
                    break
    for begin, count in runs(taken):
        if not taken[begin] and count < n and count < 2 * reach:
            taken[np.mod(np.arange(begin, begin + count), n)] = True
    return taken


def without_path(
    partial: PartialPaths, levels: FeatureLevels, surface: TargetSurface, radius: float
) -> tuple[str, ...]:
    """Warnings of walls of a ``surface`` that no level line reaches, with their place, for a ball of ``radius`` m.

    Raises
    ------
    IsfError : PARTIAL_PATH_MISSING for a wall that the ball cannot touch
    """
    warnings = []
    for feature in partial.found.features:
        if not feature.kind.wall or feature.number in partial.features:
            continue
        what = f"feature {feature.number + 1} ({feature.kind.title}, {np.degrees(feature.wall_angle):.0f} deg)"
        if levels.touched[feature.number] == 0 and not touched(partial.found, feature.number, surface, radius):
            raise IsfError(
                ErrorCode.PARTIAL_PATH_MISSING,
                f"{what} is too small for a path of its own: the ball cannot touch it",
                where=f"surface at {place_text(feature.place)}",
                advice="use a smaller tool_1.radius, or leave path.partial_paths out",
            )
        warnings.append(f"{what} at {place_text(feature.place)} lies between two levels and has no path of its own")
    return tuple(warnings)


def touched(found: FeatureMap, number: int, surface: TargetSurface, radius: float) -> bool:
    """Whether a ball of ``radius`` m touches a feature when it is put on each of its nodes.

    The survey of the levels drops balls at places in plan that are far apart on a large part, and may miss a small
    feature.
    """
    rows, columns = np.nonzero(found.label == number)
    dz_dx, dz_dy = (slope[rows, columns] for slope in found.heights.gradient())
    nodes = np.column_stack([found.heights.x[columns], found.heights.y[rows]])
    normal = -np.column_stack([dz_dx, dz_dy]) / np.sqrt(1.0 + dz_dx**2 + dz_dy**2)[:, None]
    _, contact = tip_surface.drop_tool(surface, nodes + radius * normal, radius)
    return bool((found.of_points(contact) == number).any())
