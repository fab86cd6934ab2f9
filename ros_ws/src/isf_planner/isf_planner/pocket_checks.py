"""Every pocket of the part has a loop of the tool: level sections of the mesh against the loops of the tip.

Where the tip may be at a level lies within what of the part is below the level. So every section of the mesh around
lower ground holds a loop of the tip at that level, or the pocket is too narrow for the tool there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

from isf_planner.feature_tree import RoughLoop
from isf_planner.mesh_checks import place_text
from isf_planner.mesh_input import Mesh
from isf_planner.mesh_slicing import MeshLoop, slice_mesh

Array = NDArray[np.float64]

LEFT = 0.1e-3
"""m, depth of a pocket without a loop that is not worth a word."""


def check_pockets(mesh: Mesh, levels: Array, nodes: Sequence[RoughLoop], radius: float) -> None:
    """Refuse parts with a pocket that the tool does not get into.

    Parameters
    ----------
    mesh : placed part
    levels : (K,) m ; nodes : loops of the tip ; radius : m, of the tool

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL with the pocket's place and depth, CONTOUR_LOST where a section is not closed
    """
    by_level: dict[float, list[shapely.Polygon]] = {}
    for node in nodes:
        if node.real and not node.island:
            by_level.setdefault(round(node.level, 9), []).append(node.polygon)
    for level, loops in zip(levels[:-1], slice_mesh(mesh, levels[:-1]), strict=True):
        tips = by_level.get(round(float(level), 9), [])
        for loop in loops:
            if not loop.closed:
                raise IsfError(
                    ErrorCode.CONTOUR_LOST,
                    "the section of the part is not closed",
                    where=f"level {level * 1e3:.3f} mm at {place_text(loop.points[0])}",
                    advice="repair the mesh: part.repair: true",
                )
            if loop.area > 0 and not _held(loop, tips):
                _refuse_if_deep(mesh, loop, float(level), radius)


def _held(loop: MeshLoop, tips: Sequence[shapely.Polygon]) -> bool:
    """One of the loops of the tip lies inside the section."""
    if len(tips) == 0 or len(loop.points) < 3:
        return False
    shape = shapely.Polygon(loop.points)
    return any(shapely.contains_xy(shape, *tip.exterior.coords[0]) for tip in tips) or any(
        shapely.contains_xy(shape, *tip.representative_point().coords[0]) for tip in tips
    )


def _refuse_if_deep(mesh: Mesh, loop: MeshLoop, level: float, radius: float) -> None:
    if len(loop.points) < 3:
        return
    low, high = loop.points.min(axis=0), loop.points.max(axis=0)
    near = ((mesh.vertices[:, :2] >= low) & (mesh.vertices[:, :2] <= high)).all(axis=1)
    inside = mesh.vertices[near][shapely.contains_xy(shapely.Polygon(loop.points), mesh.vertices[near][:, :2])]
    if len(inside) == 0:
        return
    deepest = inside[np.argmin(inside[:, 2])]
    depth = level - float(deepest[2])
    if depth > LEFT:
        width = float((high - low).min())
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"a pocket {width * 1e3:.1f} mm wide at level {level * 1e3:.2f} mm and {depth * 1e3:.2f} mm deeper is "
            f"narrower than the tool of radius {radius * 1e3:.2f} mm",
            where=f"mesh at {place_text(deepest)}",
            advice="use a smaller tool, or widen the pocket",
        )
