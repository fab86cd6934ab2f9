"""Which tool forms what: features below the blank from above, features that rise above it from below.

The forming tool stands on the concave side of a feature, the support tool on the other; the roles swap with the side,
also within one part (Ren 2018, 1.1; Praveen 2020, 3.2). A feature that rises above the blank is planned as a pocket
of the part seen from below: the mesh is cut at the flange level, and the part above is turned over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner.feature_tree import Feature, LoopTree
from isf_planner.mesh_input import Mesh
from isf_planner.mesh_topology import topology
from isf_planner.target_surface import TargetSurface
from isf_planner.tip_loops import TipLoop, seen_from_above

Array = NDArray[np.float64]

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
    """

    mesh: Mesh
    forming_tool: int


@dataclass(frozen=True)
class Side:
    """The planned loops of a :class:`HalfPart`, in its own view.

    Attributes
    ----------
    tree : loops and features ; surface : the sampled target, both as the forming tool sees them
    forming_tool : 1 or 2
    """

    tree: LoopTree
    surface: TargetSurface
    forming_tool: int = 1


def halves(mesh: Mesh) -> list[HalfPart]:
    """The part for the upper tool, and the part for the lower tool if anything rises above the flange.

    A mesh without an outline is handed on as it is, for the checks to refuse.
    """
    flange = flange_level(mesh)
    if flange is None:
        return [HalfPart(mesh, 1)]
    height = mesh.vertices[:, 2] - flange
    if height.max() <= RISES:
        return [HalfPart(mesh, 1)]
    low, high = mesh.vertices.copy(), mesh.vertices.copy()
    low[:, 2] = np.minimum(low[:, 2], flange)
    high[:, 2] = np.maximum(high[:, 2], flange)
    upper = [HalfPart(mesh.with_vertices(low), 1)] if height.min() < -RISES else []
    return [*upper, HalfPart(turned_over(mesh.with_vertices(high)), 2)]


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
    """All loops and features in frame ``sheet``, renumbered."""
    loops: list[TipLoop] = []
    features: list[Feature] = []
    for side in sides:
        first_loop, first_feature = len(loops), len(features)
        for loop in side.tree.loops:
            here = seen_from_above(loop) if side.forming_tool == 2 else loop
            parent = loop.parent + first_loop if loop.parent >= 0 else -1
            loops.append(
                replace(here, feature=loop.feature + first_feature, parent=parent, forming_tool=side.forming_tool)
            )
        for feature in side.tree.features:
            parent = feature.parent + first_feature if feature.parent >= 0 else -1
            number, members = feature.number + first_feature, tuple(k + first_loop for k in feature.loops)
            features.append(Feature(number, parent, feature.island, side.forming_tool, members))
    return LoopTree(tuple(loops), tuple(features))
