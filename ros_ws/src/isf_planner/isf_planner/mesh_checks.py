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
from scipy.spatial.transform import Rotation

from isf_planner import mesh_kernels
from isf_planner.mesh_input import Mesh
from isf_planner.mesh_topology import Topology, topology

Array = NDArray[np.float64]

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


def check_and_place(
    mesh: Mesh,
    clamp: tuple[float, float],
    tool_radius: float,
    *,
    place: tuple[float, float] | None = None,
) -> PlacedPart:
    """Check the mesh and move it to its place on the blank.

    Parameters
    ----------
    mesh : as loaded, m
    clamp : free sheet between the clamps in x and y, m
    tool_radius : m
    place : x and y of the outline's centre on the blank, m; None: the centre of the blank

    Raises
    ------
    IsfError : MESH_UNIT_SUSPECT, MESH_EMPTY (flat), MESH_INVERTED, MESH_NOT_MANIFOLD, MESH_NOT_HEIGHT_FIELD, MESH_OPEN
    """
    check_size(mesh, clamp, tool_radius)
    edges = topology(mesh)
    _check_manifold(mesh, edges)
    _check_facing(mesh, edges)
    flange = _check_outline(mesh, edges)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    shift = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, flange])
    if np.abs(shift[:2]).max() < CENTRED:
        shift[:2] = 0.0
    if place is not None:
        shift[:2] += place
    warnings: tuple[str, ...] = ()
    if np.abs(shift).max() > PLACED and place is None:
        text = ", ".join(f"{value * 1e3:.3f}" for value in shift)
        warnings = (f"the part was moved by ({text}) mm: its outline is centred on the blank, its flange at z = 0",)
    return PlacedPart(mesh.moved(shift), float(flange - low[2]), warnings)


def oriented(mesh: Mesh, up: str, turn: tuple[float, float, float], scale: float) -> Mesh:
    """The mesh scaled, turned about x, y and z (rad, one after the other) and with its axis ``up`` ("-y") along +z."""
    if scale == 1.0 and up == "+z" and not any(turn):
        return mesh
    axis = np.zeros(3)
    axis["xyz".index(up[1])] = 1.0 if up[0] == "+" else -1.0
    upright, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [axis])
    if up == "-z":
        upright = Rotation.from_euler("x", np.pi)
    matrix = (upright * Rotation.from_euler("xyz", turn)).as_matrix()
    matrix[np.abs(matrix) < 1e-15] = 0.0  # quarter turns are exact
    return mesh.with_vertices(scale * mesh.vertices @ matrix.T)


def check_size(mesh: Mesh, clamp: tuple[float, float], tool_radius: float) -> None:
    """Refuse what only a wrong unit explains, and what is flat: MESH_UNIT_SUSPECT, MESH_EMPTY."""
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


def _check_manifold(mesh: Mesh, edges: Topology) -> None:
    """No edge may belong to more than two facets."""
    if len(edges.crowded) == 0:
        return
    edge = edges.crowded[0]
    raise IsfError(
        ErrorCode.MESH_NOT_MANIFOLD,
        f"{len(edges.crowded)} edges belong to more than two facets: walls that branch, or facets that stand twice",
        where=f"mesh at {place_text(mesh.vertices[edges.vertices[edge]].mean(axis=0))}",
        advice="export only the upper face; set part.repair: true to remove duplicate facets",
    )


def _check_facing(mesh: Mesh, edges: Topology) -> None:
    """All facets must look up; tell a reversed surface from an overhang and from a closed body."""
    count, down, total, worst = mesh_kernels.facing(mesh.vertices, mesh.faces)
    if count == 0:
        return
    share = down / total
    where = f"mesh at {place_text(mesh.vertices[mesh.faces[worst]].mean(axis=0))}"
    if share > 0.98:
        raise IsfError(
            ErrorCode.MESH_INVERTED,
            "the normals point down: this is the lower face of the sheet, or the part is upside down",
            where=where,
            advice="export the upper face, opening towards +z, with normals up",
        )
    if len(edges.free) == 0:
        raise IsfError(
            ErrorCode.MESH_NOT_HEIGHT_FIELD,
            "the mesh is a closed body, not a surface",
            where="mesh",
            advice="export only the upper face of the formed sheet",
        )
    if len(edges.contradicting):
        contradiction = mesh.vertices[edges.vertices[edges.contradicting[0]]].mean(axis=0)
        raise IsfError(
            ErrorCode.MESH_INVERTED,
            "neighbouring facets have opposite orientation",
            where=f"mesh at {place_text(contradiction)}",
            advice="unify the normals so that all point up",
        )
    raise IsfError(
        ErrorCode.MESH_NOT_HEIGHT_FIELD,
        f"{count} facets face down: an overhang, or more than the upper face",
        where=where,
        advice="a tool from above cannot reach under an overhang; export only the upper face",
    )


def _check_outline(mesh: Mesh, edges: Topology) -> float:
    """One outline, at the level of the highest point, and no other free edges; the level (m), which is the flange."""
    loops = edges.free_loops()
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
    lowest = outline[np.argmin(outline[:, 2])]
    if outline[:, 2].mean() < 0.5 * (low + high):
        raise IsfError(
            ErrorCode.MESH_INVERTED,
            "the part opens downwards: its outline is its lowest level",
            where="mesh",
            advice="turn it so that it opens towards +z",
        )
    if high - lowest[2] > LEVEL_TOLERANCE:
        raise IsfError(
            ErrorCode.MESH_OPEN,
            f"the outline lies {(high - lowest[2]) * 1e3:.2f} mm below the highest point",
            where=f"mesh at {place_text(lowest)}",
            advice="extend the surface to a plane flange; only DSIF forms what rises above it",
        )
    return float(high)
