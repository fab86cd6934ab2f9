"""Where the springback of a part is computed: few places that stand for the thousands of points of its path.

On loops about 1 mm of depth apart, the middle of every stretch with like features and the boundaries between
stretches (Ren 2018, 4.2.5). Places that a symmetry of part and clamp maps onto each other share one computation; the
symmetries are found, not told.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from isf_springback.database.feature_clusters import ClusterOptions, Labels, cluster_loop
from isf_springback.database.loop_features import loop_features

Index = NDArray[np.int64]


@dataclass(frozen=True)
class ControlPointOptions:
    """Choices of the control points.

    Attributes
    ----------
    loop_increment : m of depth between control loops (published: 1 mm)
    critical_length : m, shortest stretch (a published setting; 0: 0.8 tool radii, just below the 0.9 tool radii of
        a sharp corner seen through the window of the curvature)
    most_clusters : per loop
    across : use the curvature across the loops as a third feature
    symmetry_tolerance : m, how exactly a symmetry must map loop onto loop
    """

    loop_increment: float = 1e-3
    critical_length: float = 0.0
    most_clusters: int = 16
    across: bool = False
    symmetry_tolerance: float = 0.2e-3


@dataclass(frozen=True)
class ControlLoop:
    """Control points of one contour, M of them.

    Attributes
    ----------
    index : the contour
    labels : (N,) stretch of every point of the contour
    places : (M,) numbers of contour points, in path order
    central : (M,) bool, middle of a stretch; else a boundary
    points : (M, 3) m, contact points there
    same_as : (M,) number of the control point of this loop that is computed for it (its own, or its mirror image)
    """

    index: int
    labels: Labels
    places: Index
    central: NDArray[np.bool_]
    points: Array
    same_as: Index

    @property
    def computed(self) -> Index:
        """Control points that need a computation of their own."""
        return np.unique(self.same_as)


def control_points(
    contours: Sequence[Contour],
    tool_radius: float | Mapping[int, float],
    clamp_size: tuple[float, float],
    options: ControlPointOptions = ControlPointOptions(),
) -> list[ControlLoop]:
    """Control loops of a whole plan, in its order; ``tool_radius`` m of the forming tool, or by its number."""
    chosen = control_contours(contours, options.loop_increment)
    symmetries = part_symmetries([contours[k] for k in chosen], clamp_size, options.symmetry_tolerance)
    loops = []
    for k in chosen:
        around = _neighbours(contours, k) if options.across else ()
        radius = tool_radius if isinstance(tool_radius, float) else tool_radius[contours[k].forming_tool]
        loops.append(control_loop(contours[k], radius, options, symmetries, around))
    return loops


def control_loop(
    contour: Contour,
    tool_radius: float,
    options: ControlPointOptions = ControlPointOptions(),
    symmetries: Sequence[Array] = (),
    neighbours: tuple[Contour, ...] = (),
) -> ControlLoop:
    """Control points of one contour."""
    features = loop_features(contour, tool_radius, neighbours).normalised(tool_radius, with_across=options.across)
    length = float(np.linalg.norm(np.diff(contour.contact, axis=0), axis=1).sum())
    spacing = length / max(len(contour) - 1, 1)
    shortest = max(3, round((options.critical_length or 0.8 * tool_radius) / spacing))
    labels = cluster_loop(features, ClusterOptions(shortest, options.most_clusters), closed=contour.closed)
    places, central = _centres_and_boundaries(labels)
    points = contour.contact[places]
    same_as = _same_places(points, central, symmetries, 0.5 * tool_radius)
    return ControlLoop(contour.index, labels, places, central, points, same_as)


def control_contours(contours: Sequence[Contour], increment: float) -> list[int]:
    """Numbers of the contours that become control loops: about ``increment`` m of depth apart, each feature's last."""
    chosen: list[int] = []
    last: dict[tuple[int, int], float] = {}
    ends = {(contour.feature, contour.stage): k for k, contour in enumerate(contours)}
    for k, contour in enumerate(contours):
        key = contour.feature, contour.stage
        depth = abs(float(contour.contact[:, 2].mean()))
        if abs(depth - last.get(key, 0.0)) >= increment - 1e-6 or ends[key] == k:
            chosen.append(k)
            last[key] = depth
    return chosen


def part_symmetries(loops: Sequence[Contour], clamp_size: tuple[float, float], tolerance: float) -> list[Array]:
    """Maps (2, 2) of the plan view, other than identity, under which clamp and all ``loops`` stay the same."""
    found = []
    turns = (0, 1, 2, 3) if abs(clamp_size[0] - clamp_size[1]) < 1e-6 else (0, 2)
    trees = [cKDTree(_dense(loop.contact[:, :2])) for loop in loops]
    for turn in turns:
        angle = 0.5 * np.pi * turn
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).round()
        for mirror in (np.eye(2), np.diag([1.0, -1.0])):
            chart = rotation @ mirror
            if np.array_equal(chart, np.eye(2)):
                continue
            images = (
                tree.query(loop.contact[:, :2] @ chart.T)[0].max() for tree, loop in zip(trees, loops, strict=True)
            )
            if all(distance < tolerance for distance in images):
                found.append(chart)
    return found


def _dense(loop: Array) -> Array:
    """``loop`` (N, 2) with four points per step, so that nearest points tell the distance of curves."""
    after = np.roll(loop, -1, axis=0)
    return np.vstack([loop + share * (after - loop) for share in (0.0, 0.25, 0.5, 0.75)])


def _neighbours(contours: Sequence[Contour], k: int) -> tuple[Contour, ...]:
    """Loops of the same feature before and after; () at its ends."""
    key = contours[k].feature, contours[k].stage
    around = [contours[j] for j in (k - 1, k + 1) if 0 <= j < len(contours)]
    around = [loop for loop in around if (loop.feature, loop.stage) == key]
    return tuple(around) if len(around) == 2 else ()


def _centres_and_boundaries(labels: Labels) -> tuple[Index, NDArray[np.bool_]]:
    """Path-ordered point numbers: first point of each stretch, and its middle; one stretch: its first point alone."""
    n = len(labels)
    starts = np.flatnonzero(labels != np.roll(labels, 1))
    if len(starts) < 2:
        return np.zeros(1, dtype=np.int64), np.ones(1, dtype=bool)
    ends = np.append(starts[1:], starts[0] + n)
    centres = ((starts + ends) // 2) % n
    places = np.concatenate([starts, centres])
    central = np.arange(len(places)) >= len(starts)
    order = np.argsort(places, kind="stable")
    return places[order], central[order]


def _same_places(points: Array, central: NDArray[np.bool_], symmetries: Sequence[Array], tolerance: float) -> Index:
    """(M,) the lowest-numbered control point of the same kind that a symmetry maps onto each one."""
    same = np.arange(len(points), dtype=np.int64)
    for chart in symmetries:
        image = points[:, :2] @ chart.T
        for kind in (True, False):
            members = np.flatnonzero(central == kind)
            if len(members) == 0:
                continue
            distance, nearest = cKDTree(points[members, :2]).query(image[members])
            partner = members[nearest]
            near = distance < tolerance
            for here, there in zip(members[near], partner[near], strict=True):
                low = min(same[here], same[there])
                same[(same == same[here]) | (same == same[there])] = low
    return same
