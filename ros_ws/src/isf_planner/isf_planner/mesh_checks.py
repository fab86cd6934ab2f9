"""Is the mesh the upper face of a formable part, and where does it sit on the blank?

Convention of the planner: the mesh is one open surface, the upper face of the formed sheet, with or without a
flange. Its outline is the flange level and its highest level; seen from above every point is covered once (a
height field). It is placed with the outline's centre on the centre of the blank and the outline at z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from isf_planner.mesh_input import Mesh

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LEVEL_TOLERANCE = 0.05e-3
"""m, how far the outline may deviate from the flange level."""

TOO_LARGE = 3.0
"""A part this many times larger than the clamp is taken for a mesh in another unit."""

CENTRED = 0.05e-3
"""m, an outline this close to the centre stays where it is: facets make a round outline this uneven."""

PLACED = 1e-6
"""m, shifts below this are not worth a warning."""


@dataclass(frozen=True)
class PlacedPart:
    """A checked mesh in frame ``sheet``.

    Attributes
    ----------
    mesh : Mesh, flange level at z = 0
    depth : m, how far the lowest point lies below the flange
    warnings : what was moved
    """

    mesh: Mesh
    depth: float
    warnings: tuple[str, ...]


def place_text(point: Array) -> str:
    """A place for people, mm."""
    return ", ".join(f"{axis} = {value * 1e3:.1f}" for axis, value in zip("xyz", point, strict=False)) + " mm"


def check_and_place(mesh: Mesh, clamp: tuple[float, float], tool_radius: float) -> PlacedPart:
    """Check the mesh and move it to its place on the blank.

    Parameters
    ----------
    mesh : as loaded, m
    clamp : free sheet between the clamps in x and y, m
    tool_radius : m

    Raises
    ------
    IsfError : MESH_UNIT_SUSPECT, MESH_EMPTY (flat), MESH_INVERTED, MESH_NOT_HEIGHT_FIELD, MESH_OPEN
    """
    _check_size(mesh, clamp, tool_radius)
    _check_facing(mesh)
    _check_outline(mesh)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    shift = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]])
    if np.abs(shift[:2]).max() < CENTRED:
        shift[:2] = 0.0
    warnings: tuple[str, ...] = ()
    if np.abs(shift).max() > PLACED:
        text = ", ".join(f"{value * 1e3:.3f}" for value in shift)
        warnings = (f"the part was moved by ({text}) mm: its outline is centred on the blank, its flange at z = 0",)
    return PlacedPart(mesh.moved(shift), float(high[2] - low[2]), warnings)


def _check_size(mesh: Mesh, clamp: tuple[float, float], tool_radius: float) -> None:
    size = np.ptp(mesh.vertices, axis=0)
    text = " x ".join(f"{value * 1e3:.4g}" for value in size) + " mm"
    advice = "check part.unit in the job"
    if (size[:2] > TOO_LARGE * np.asarray(clamp)).any():
        what = f"the part would be {text}, more than {TOO_LARGE:g} times the clamp"
        raise IsfError(ErrorCode.MESH_UNIT_SUSPECT, what, where="mesh", advice=advice)
    if size[:2].max() < 2.0 * tool_radius:
        what = f"the part would be {text}, smaller than the tool of radius {tool_radius * 1e3:.4g} mm"
        raise IsfError(ErrorCode.MESH_UNIT_SUSPECT, what, where="mesh", advice=advice)
    if size[2] < LEVEL_TOLERANCE:
        what = f"the part is flat ({size[2] * 1e3:.3f} mm high): there is nothing to form"
        raise IsfError(ErrorCode.MESH_EMPTY, what, where="mesh", advice="z must be the forming direction")


def _check_facing(mesh: Mesh) -> None:
    """All facets must look up; tell a reversed surface from an overhang and from a closed body."""
    corners = mesh.corners()
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    projected = 0.5 * cross[:, 2]
    down = projected < -1e-6 * np.linalg.norm(cross, axis=1)
    if not down.any():
        return
    share = -projected[down].sum() / np.abs(projected).sum()
    worst = int(np.argmin(projected))
    where = f"mesh at {place_text(corners[worst].mean(axis=0))}"
    if share > 0.98:
        raise IsfError(
            ErrorCode.MESH_INVERTED,
            "the normals point down: this is the lower face of the sheet, or the part is upside down",
            where=where,
            advice="export the upper face, opening towards +z, with normals up",
        )
    if len(_boundary_edges(mesh)) == 0:
        raise IsfError(
            ErrorCode.MESH_NOT_HEIGHT_FIELD,
            "the mesh is a closed body, not a surface",
            where="mesh",
            advice="export only the upper face of the formed sheet",
        )
    contradiction = _contradicting_edge(mesh)
    if contradiction is not None:
        raise IsfError(
            ErrorCode.MESH_INVERTED,
            "neighbouring facets have opposite orientation",
            where=f"mesh at {place_text(contradiction)}",
            advice="unify the normals so that all point up",
        )
    raise IsfError(
        ErrorCode.MESH_NOT_HEIGHT_FIELD,
        f"{int(down.sum())} facets face down: an overhang, or more than the upper face",
        where=where,
        advice="a tool from above cannot reach under an overhang; export only the upper face",
    )


def _check_outline(mesh: Mesh) -> None:
    """One outline, at the level of the highest point, and no other free edges."""
    edges = _boundary_edges(mesh)
    loops = _loops_of(edges)
    if not loops:
        raise IsfError(
            ErrorCode.MESH_NOT_HEIGHT_FIELD,
            "the mesh is a closed body, not a surface",
            where="mesh",
            advice="export only the upper face of the formed sheet",
        )
    loops.sort(key=lambda loop: -float(np.ptp(mesh.vertices[loop, :2], axis=0).max()))
    if len(loops) > 1:
        points = mesh.vertices[loops[1]]
        raise IsfError(
            ErrorCode.MESH_OPEN,
            f"{len(loops) - 1} free edges besides the outline: a hole, a crack or a second surface",
            where=f"mesh at {place_text(points.mean(axis=0))}, {np.ptp(points, axis=0).max() * 1e3:.2f} mm wide",
            advice="close it in the CAD model; holes are cut after forming",
        )
    outline = mesh.vertices[loops[0]]
    low, high = mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()
    if outline[:, 2].mean() < 0.5 * (low + high):
        raise IsfError(
            ErrorCode.MESH_INVERTED,
            "the part opens downwards: its outline is its lowest level",
            where="mesh",
            advice="turn it so that it opens towards +z",
        )
    lowest = outline[np.argmin(outline[:, 2])]
    if high - lowest[2] > LEVEL_TOLERANCE:
        raise IsfError(
            ErrorCode.MESH_OPEN,
            f"the outline lies {(high - lowest[2]) * 1e3:.2f} mm below the highest point",
            where=f"mesh at {place_text(lowest)}",
            advice="extend the surface to a plane flange; nothing may rise above it",
        )


def _boundary_edges(mesh: Mesh) -> Indices:
    """(E, 2) vertex indices of the edges that belong to one facet only."""
    edges = np.sort(np.vstack([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(unique[count == 1])


def _loops_of(edges: Indices) -> list[Indices]:
    """Vertex indices of every connected set of boundary edges."""
    if len(edges) == 0:
        return []
    vertices, local = np.unique(edges, return_inverse=True)
    local = local.reshape(edges.shape)
    graph = coo_matrix((np.ones(len(edges)), (local[:, 0], local[:, 1])), shape=(len(vertices), len(vertices)))
    count, label = connected_components(graph, directed=False)
    return [vertices[label == k] for k in range(count)]


def _contradicting_edge(mesh: Mesh) -> Array | None:
    """(3,) m, middle of an edge that two facets run through in the same direction, or None."""
    edges = np.vstack([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    unique, count = np.unique(edges, axis=0, return_counts=True)
    twice = unique[count > 1]
    return np.asarray(mesh.vertices[twice[0]].mean(axis=0)) if len(twice) else None
