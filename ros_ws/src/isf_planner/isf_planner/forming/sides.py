"""Which tool forms what: features below the blank from above, features that rise above it from below.

The forming tool stands on the concave side of a feature, the support tool on the other; the roles swap with the side,
also within one part (Ren 2018, 1.1; Praveen 2020, 3.2). A feature that rises above the blank is planned as a pocket
of the part seen from below: the mesh is cut at the flange level, and the part above is turned over. With islands
formed by the other tool (``path.islands: swap``), the floor that an island stands on is its flange, and so on in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from isf_core.files.job import Job
from isf_core.types import Array

from isf_planner.forming import islands
from isf_planner.loops.sections import Feature, LoopTree, within
from isf_planner.loops.tip_loops import TipLoop, seen_from_above
from isf_planner.part.meshes import Mesh, topology
from isf_planner.paths.partial_paths import PartialPaths
from isf_planner.surface.target_surface import TargetSurface

ON_LEVEL = 1e-9
"""m, a vertex this close to the level of the flange lies on it."""

RISES = 0.05e-3
"""m above the flange from which something is a feature."""

UPSIDE_DOWN = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class HalfPart:
    """What one tool forms of a part.

    Attributes
    ----------
    mesh : opening upwards, seen from the forming tool: turned over for the lower tool
    forming_tool : 1 or 2
    base : m, z in frame ``sheet`` of the flange of ``mesh``: 0, or the floor that an island stands on
    """

    mesh: Mesh
    forming_tool: int
    base: float = 0.0

    def in_sheet(self, points: Array) -> Array:
        """Points (..., 3) m of the view of the forming tool in frame ``sheet``."""
        return in_sheet(points, self.forming_tool, self.base)


@dataclass(frozen=True)
class Side:
    """The planned loops of a :class:`HalfPart`, in its own view.

    Attributes
    ----------
    tree : loops and features ; surface : the sampled target, both as the forming tool sees them
    forming_tool : 1 or 2
    base : m, as in :class:`HalfPart`
    partial : paths of its features, None where the job does not ask for them
    left : m, most material that the ball leaves where it does not fit
    """

    tree: LoopTree
    surface: TargetSurface
    forming_tool: int = 1
    base: float = 0.0
    partial: PartialPaths | None = None
    left: float = 0.0

    def in_sheet(self, points: Array) -> Array:
        """Points (..., 3) m of the view of the forming tool in frame ``sheet``."""
        return in_sheet(points, self.forming_tool, self.base)

    def seen(self, points: Array) -> Array:
        """Points (..., 3) m of frame ``sheet`` in the view of the forming tool."""
        moved = points - np.array([0.0, 0.0, self.base])
        return np.asarray(moved * UPSIDE_DOWN if self.forming_tool == 2 else moved)


def in_sheet(points: Array, forming_tool: int, base: float) -> Array:
    """Points (..., 3) m as ``forming_tool`` sees them, over a flange at ``base`` m, in frame ``sheet``."""
    upright = points * UPSIDE_DOWN if forming_tool == 2 else points
    return np.asarray(upright + np.array([0.0, 0.0, base]))


def parts(mesh: Mesh, *, swap_islands: bool) -> list[HalfPart]:
    """What the tools form of a part, in the order of forming: what holds a floor before what stands on it."""
    flange = flange_level(mesh) if swap_islands else None
    if flange is None:
        return halves(mesh)
    rest, found = islands.taken_out(mesh, flange)
    inner = [
        replace(part, base=part.base + island.level)
        for island in found
        for part in parts(island.mesh, swap_islands=True)
    ]
    return [*halves(rest), *inner]


def halves(mesh: Mesh) -> list[HalfPart]:
    """The part for the upper tool, and the part for the lower tool if anything rises above the flange.

    A mesh without an outline is handed on as it is, for the checks to refuse. Facets that cross the level of the flange
    are cut there: clamped as a whole they would make another wall.
    """
    flange = flange_level(mesh)
    if flange is None:
        return [HalfPart(mesh, 1)]
    height = mesh.vertices[:, 2] - flange
    if height.max() <= RISES:
        return [HalfPart(mesh, 1)]
    if height.min() < -RISES:
        mesh = cut_at(mesh, flange)
    low, high = mesh.vertices.copy(), mesh.vertices.copy()
    low[:, 2] = np.minimum(low[:, 2], flange)
    high[:, 2] = np.maximum(high[:, 2], flange)
    upper = [HalfPart(mesh.with_vertices(low), 1)] if height.min() < -RISES else []
    return [*upper, HalfPart(turned_over(mesh.with_vertices(high)), 2)]


def cut_at(mesh: Mesh, level: float) -> Mesh:
    """The mesh with the facets that cross z = ``level`` m divided there; the very same mesh where none does."""
    height = mesh.vertices[:, 2] - level
    side = np.where(np.abs(height) <= ON_LEVEL, 0, np.sign(height)).astype(np.int64)
    first, second = mesh.faces, np.roll(mesh.faces, -1, axis=1)  # ends of the edges of every facet
    crossing = side[first] * side[second] < 0
    if not crossing.any():
        return mesh
    edges = np.sort(np.stack([first[crossing], second[crossing]], axis=1), axis=1)
    edges, number = np.unique(edges, axis=0, return_inverse=True)
    a, b = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]]
    share = (level - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    between = np.full(mesh.faces.shape, -1)
    between[crossing] = len(mesh.vertices) + number.ravel()
    divided = crossing.any(axis=1)
    faces: list[tuple[int, int, int]] = []
    for (p, q, r), (pq, qr, rp) in zip(mesh.faces[divided].tolist(), between[divided].tolist(), strict=True):
        for (x, y, z), (xy, yz, zx) in (
            ((p, q, r), (pq, qr, rp)),
            ((q, r, p), (qr, rp, pq)),
            ((r, p, q), (rp, pq, qr)),
        ):
            if xy >= 0 and zx >= 0:  # x alone on its side
                faces += [(x, xy, zx), (xy, y, z), (xy, z, zx)]
            elif yz >= 0 and xy < 0 and zx < 0:  # x on the level
                faces += [(x, y, yz), (x, yz, z)]
    vertices = np.vstack([mesh.vertices, np.column_stack([(a + share * (b - a))[:, :2], np.full(len(edges), level)])])
    return Mesh(vertices, np.vstack([mesh.faces[~divided], faces]))


def turned_over(mesh: Mesh) -> Mesh:
    """The mesh mirrored at z = 0; seen from above its facets keep their sense, so they look up as before."""
    return mesh.with_vertices(mesh.vertices * UPSIDE_DOWN)


def flange_level(mesh: Mesh) -> float | None:
    """m, mean z of the longest outline; None for a closed body."""
    edges = topology(mesh)
    free = edges.vertices[edges.free]
    if not len(free):
        return None
    # weighted by length, so that a small hole does not move it; an open part has one long outline
    ends = mesh.vertices[free]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(np.average(ends[:, :, 2].mean(axis=1), weights=np.maximum(length, 1e-12)))


def swapped(job: Job, forming_tool: int) -> Job:
    """The job with the forming tool as tool_1, for planning a half in its own view."""
    if forming_tool == 1 or job.tool_2 is None:
        return job
    return job.model_copy(update={"tool_1": job.tool_2, "tool_2": job.tool_1})


def merged(sides: Sequence[Side]) -> LoopTree:
    """All loops and features in frame ``sheet``, renumbered; what stands on a floor is a child of its feature."""
    loops: list[TipLoop] = []
    features: list[Feature] = []
    for index, side in enumerate(sides):
        first_loop, first_feature = len(loops), len(features)
        held = holder(side, sides[:index])
        top = first_number(sides, held[0]) + held[1] if held else -1
        for loop in side.tree.loops:
            here = seen_from_above(loop, side.base) if side.forming_tool == 2 else loop.raised(side.base)
            parent = loop.parent + first_loop if loop.parent >= 0 else -1
            loops.append(
                replace(here, feature=loop.feature + first_feature, parent=parent, forming_tool=side.forming_tool)
            )
        for feature in side.tree.features:
            parent = feature.parent + first_feature if feature.parent >= 0 else top
            number, members = feature.number + first_feature, tuple(k + first_loop for k in feature.loops)
            features.append(Feature(number, parent, feature.island, side.forming_tool, members))
    return LoopTree(tuple(loops), tuple(features))


def first_number(sides: Sequence[Side], index: int) -> int:
    """Number of the first feature of the side ``index`` among the features of all sides."""
    return sum(len(side.tree.features) for side in sides[:index])


def holder(side: Side, earlier: Sequence[Side]) -> tuple[int, int] | None:
    """Index of the side, and number of its feature, on whose floor ``side`` stands: the narrowest around it."""
    if side.base == 0.0 or not side.tree.loops:
        return None
    around = []
    for index, other in enumerate(earlier):
        for feature in other.tree.features:
            shape = shapely.Polygon(other.tree.loops[feature.loops[-1]].points)
            if not feature.island and within(side.tree.loops[0].points, shape):
                around.append((shape.area, index, feature.number))
    return min(around)[1:] if around else None
