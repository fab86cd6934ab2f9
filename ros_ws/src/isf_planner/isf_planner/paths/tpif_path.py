"""Two-point forming over a die: the part stands up over the blank holder, which travels down with the tool.

The part is a surface that rises from its flange (the upper face of the formed sheet). The die stands under it, full or
partial, and one tool works from the top of the part downwards and outwards (Lu 2016, 3.4). While a contour is formed
the blank holder stands at the height of that contour: frame ``sheet`` travels with the clamped blank, so in it the
tip is at z = 0 and the die rises; ``Contour.holder_height`` tells how far the holder has moved from its start, where
the blank lies on top of the die.

Planned is in the frame of the die, which is frame ``sheet`` before the holder moves: top of the part at z = 0,
flange of the finished part at minus its height.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from numpy.typing import NDArray

from isf_planner.checks import part_checks
from isf_planner.checks.die_checks import check_die, check_tool, load_die
from isf_planner.forming.sides import Side, turned_over
from isf_planner.loops import level_spacing, sections, tip_loops
from isf_planner.loops.sections import RoughLoop, link
from isf_planner.part import mesh_checks
from isf_planner.part.meshes import Mesh, topology
from isf_planner.part.warning_places import in_sheet
from isf_planner.paths import contour_making, tool_paths
from isf_planner.paths.contour_making import contour_of
from isf_planner.paths.joined_paths import TipPath
from isf_planner.surface import target_surface, tip_surface
from isf_planner.surface.target_surface import TargetSurface


@dataclass(frozen=True)
class TpifPart:
    """What is planned of a part over a die.

    Attributes
    ----------
    side : loops around the part, in the frame of the die, and the sampled target there
    mesh : the part in frame ``sheet`` at the end: flange at z = 0
    height : m, of the part over its flange
    warnings : what was moved
    """

    side: Side
    mesh: Mesh
    height: float
    warnings: tuple[str, ...]


def plan_part(loaded: Mesh, job_file: JobFile, step: Callable[[str, float], None]) -> TpifPart:
    """Loops of the part of a job, whose mesh is ``loaded``.

    Raises
    ------
    IsfError : as for other parts; MESH_INVERTED for a part that does not rise from its flange, DIE_COLLISION
    """
    job, rig = job_file.job, job_file.rig
    below = turned_over(loaded)
    try:
        part = mesh_checks.check_and_place(below, rig.clamp.size, job.tool_1.radius, place=job.place)
        part_checks.check_fit(part, job, rig)
        told = [*part.warnings, *part_checks.check_wall_angle(part.mesh, job, job_file.material)]
    except IsfError as error:
        if error.code is not ErrorCode.MESH_INVERTED:
            what, where = (in_sheet(text, 2, 0.0) for text in (error.what, error.where))
            raise IsfError(error.code, what, where=where, advice=error.advice) from error
        raise IsfError(
            ErrorCode.MESH_INVERTED,
            "the part has to rise from its flange, normals up: over a die it stands upwards",
            where="mesh",
            advice="turn the part over, or use process SPIF or DSIF",
        ) from error
    warnings = [in_sheet(text, 2, 0.0) for text in told]  # the part was turned over for the checks
    height = part.depth
    finished = turned_over(part.mesh)
    over_die = finished.moved(np.array([0.0, 0.0, -height]))
    check_die(over_die, height, job_file)

    radius = job.tool_1.ball_radius
    step("sampling the surface", 0.05)
    surface = _with_flange(target_surface.fine_surface(over_die, radius), over_die, height)
    step("dropping the tool", 0.3)
    x, y, tip_height = tip_surface.tip_grid(surface, radius)
    nodes: list[RoughLoop] = []
    front: list[int] = []
    for level in level_spacing.levels(sections.TipGrid(x, y, tip_height, height), surface, job):
        front = link(nodes, _around(x, y, tip_height, float(level)), front)
    tree = sections.settle_all(nodes, surface, job, lambda k, n: step(f"contour {k + 1} of {n}", 0.4 + 0.5 * k / n))
    return TpifPart(Side(tree, surface), finished, height, tuple(warnings))


def make_contours(part: TpifPart, job_file: JobFile, plan_id: str) -> tuple[Contour, ...]:
    """Contours from the top down, each with the height of the blank holder, checked against the die.

    Several features are formed level by level, as the holder carries all of them: then only separate contours.

    Raises
    ------
    IsfError : FEATURES_MIXED (joined paths on several features), PART_TOO_SMALL_FOR_TOOL (flat tip), PATH_BROKEN,
        DIE_COLLISION (no room for the sheet between tool and die)
    """
    job, features = job_file.job, part.side.tree.features
    joined = job.path.style == "spiral" or job.path.transition == "ramp"
    if joined and len(features) > 1:
        raise IsfError(
            ErrorCode.FEATURES_MIXED,
            f"over a die {len(features)} features are formed level by level: no joined path leads through them",
            where="path.style, path.transition",
            advice="use style contours with transition step",
        )
    paths: list[tuple[TipPath, int]] = []
    for number, feature in enumerate(features):
        chain = [part.side.tree.loops[k] for k in feature.loops]
        paths += [(path, number) for path in tool_paths.feature_paths(chain, part.side, job)]
    if not joined:
        paths.sort(key=lambda item: -float(item[0].points[:, 2].min()))
    contours: list[Contour] = []
    for k, (path, number) in enumerate(paths):
        holder = float(path.points[:, 2].min())
        seen = replace(path, points=path.points - np.array([0.0, 0.0, holder]), feature=number)
        made = contour_of(seen, job, plan_id, k, len(paths))
        apart = bool(contours) and contours[-1].feature != number
        contours.append(replace(made, retract=apart, holder_height=holder))
    check_tool(tuple(contours), job, load_die(job_file), part.side.surface)
    return tuple(contour_making.with_speed(contours, [path.joins for path, _ in paths], job.path.acceleration))


def _with_flange(surface: TargetSurface, mesh: Mesh, height: float) -> TargetSurface:
    """The surface with the flange's level beside the mesh, where the sampler knows nothing of the holder's travel."""
    outline = _outline(mesh)
    gx, gy = np.meshgrid(surface.x, surface.y)
    beside = ~shapely.contains_xy(outline.buffer(surface.pitch), gx, gy)
    # the sampler leaves 0 where no facet is; along the outline the flange itself is at -height
    z = np.where(beside | ((surface.z == 0.0) & _near_border(outline, gx, gy, 2 * surface.pitch)), -height, surface.z)
    normal = np.where((z != surface.z)[..., None], 0.0, surface.normal_xy)
    return replace(surface, z=z, normal_xy=normal)


def _outline(mesh: Mesh) -> shapely.Geometry:
    """What the mesh covers seen from above, m; it has one outline, and no holes."""
    edges = topology(mesh)
    lines = shapely.linestrings(mesh.vertices[edges.vertices[edges.free], :2])
    return shapely.union_all(shapely.get_parts(shapely.polygonize(lines)))


def _near_border(outline: shapely.Geometry, gx: Array, gy: Array, distance: float) -> NDArray[np.bool_]:
    inner = outline.buffer(-distance)
    return np.asarray(~shapely.contains_xy(inner, gx, gy))


def _around(x: Array, y: Array, height: Array, level: float) -> list[RoughLoop]:
    """Loops around what stands higher than ``level``, clockwise."""
    loops = tip_loops.loops_at(x, y, height, level)
    inner = [points for points, island in loops if island]
    if inner:
        place = np.append(inner[0].mean(axis=0), level)
        raise IsfError(
            ErrorCode.FEATURES_MIXED,
            "the part has a hollow: a tool over a die works around what stands up",
            where=f"part at {mesh_checks.place_text(place)}",
            advice="form the hollow with process SPIF or DSIF",
        )
    return [RoughLoop(level, points[::-1], True) for points, _ in loops]
