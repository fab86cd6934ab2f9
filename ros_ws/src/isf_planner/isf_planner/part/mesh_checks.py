"""Is the mesh the upper face of a formable part, where does it sit on the blank, and which of its faults are repaired?

Convention of the planner: the mesh is one open surface, the upper face of the formed sheet, with or without a
flange. Its outline is the flange level and its highest level; seen from above every point is covered once (a
height field). It is placed with the outline's centre on the centre of the blank and the outline at z = 0.

Repaired is what is wrong with a mesh and not with the part: cracks, duplicate facets, turned facets, small holes.
Every repair is reported. The shape is not changed beyond that: vertices of cracks move by at most 20 um, a hole is
closed by plane facets between the points of its rim and must not be wider than the tool.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array, Indices
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from isf_planner.part import mesh_kernels, meshes
from isf_planner.part.meshes import Mesh, Topology, topology

LEVEL_TOLERANCE = 0.05e-3
"""m, how far the outline may deviate from the flange level."""

TOO_LARGE = 3.0
"""A part this many times larger than the clamp is taken for a mesh in another unit."""

CENTRED = 0.05e-3
"""m, an outline this close to the centre stays where it is: facets make a round outline this uneven."""

PLACED = 1e-6
"""m, shifts below this are not worth a warning."""

SMALLEST_FACET = 1e-10
"""m^2; the normal of a smaller facet says nothing about the wall."""


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


def steepest_wall(mesh: Mesh) -> tuple[float, Array]:
    """rad, the largest wall angle of the facets of ``mesh``, and the middle (3,) m of that facet."""
    angle, worst = mesh_kernels.steepest(mesh.vertices, mesh.faces, SMALLEST_FACET)
    return float(angle), np.asarray(mesh.vertices[mesh.faces[worst]].mean(axis=0))


def load_part(job_file: JobFile) -> tuple[Mesh, tuple[str, ...]]:
    """The mesh of a job with a part, upright and repaired, not placed yet; and what was repaired.

    Raises IsfError as :func:`isf_planner.part.meshes.load_mesh`, MESH_UNIT_SUSPECT, and as :func:`repair`.
    """
    part, tool = job_file.job.part, job_file.job.tool_1.radius
    assert part is not None
    assert job_file.mesh is not None
    mesh = oriented(meshes.load_mesh(job_file.mesh, part.unit), part.up, part.turn, part.scale)
    check_size(mesh, job_file.rig.clamp.size, tool)  # distances of repairs mean nothing in a wrong unit
    return repair(mesh, 2.0 * tool) if part.repair else (mesh, ())


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


def check_size(mesh: Mesh, clamp: tuple[float, float], tool_radius: float, of: str = "part") -> None:
    """Refuse what only a wrong unit explains, and what is flat: MESH_UNIT_SUSPECT, MESH_EMPTY.

    ``of``: the section of the job that names the mesh.
    """
    size = np.ptp(mesh.vertices, axis=0)
    text = " x ".join(f"{value * 1e3:.4g}" for value in size) + " mm"
    where, advice = "mesh" if of == "part" else f"{of}.mesh", f"check {of}.unit in the job"
    if (size[:2] > TOO_LARGE * np.asarray(clamp)).any():
        what = f"the {of} would be {text}, more than {TOO_LARGE:g} times the clamp"
        raise IsfError(ErrorCode.MESH_UNIT_SUSPECT, what, where=where, advice=advice)
    if size[:2].max() < 2.0 * tool_radius:
        what = f"the {of} would be {text}, smaller than the tool of radius {tool_radius * 1e3:.4g} mm"
        raise IsfError(ErrorCode.MESH_UNIT_SUSPECT, what, where=where, advice=advice)
    if size[2] < LEVEL_TOLERANCE:
        what = f"the {of} is flat ({size[2] * 1e3:.3f} mm high): there is nothing to form"
        raise IsfError(ErrorCode.MESH_EMPTY, what, where=where, advice="z must be the forming direction")


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


WELD_DISTANCE = 20e-6
"""m; free vertices this close are the two sides of a crack."""

MERGED = 1e-6
"""m; a vertex this close to the end of an edge is the end."""


def repair(mesh: Mesh, widest_hole: float) -> tuple[Mesh, tuple[str, ...]]:
    """The repaired mesh and what was done, with places; a mesh without faults comes back as it is.

    ``widest_hole`` (m): larger holes stay open and are refused later with their place.
    """
    reported: list[str] = []
    edges = topology(mesh)
    if _comes_apart(mesh, edges):
        mesh, edges = _weld(mesh, edges, reported)
    for _ in range(3):  # a facet has three edges, of which one is cut at a time
        if _comes_apart(mesh, edges):
            mesh, edges = _stitch(mesh, edges, reported)
    if len(edges.crowded):
        mesh, edges = _drop_duplicates(mesh, edges, reported)
    if len(edges.contradicting):
        mesh, edges = _orient(mesh, edges, reported)
    if len(edges.free_loops()) > 1:
        mesh = _fill_holes(mesh, edges, widest_hole, reported)
    return mesh, tuple(reported)


def _comes_apart(mesh: Mesh, edges: Topology) -> bool:
    """Whether there are free edges besides the outline, or a seam that ends at the outline and so is a part of it.

    Along such a seam the outline runs back beside itself: a free vertex lies at an edge that is not next to it. What
    hangs together by free edges shorter than the weld distance is next to each other: the outline may be that fine.
    """
    if len(edges.free_loops()) > 1:
        return True
    free = edges.vertices[edges.free]
    vertices, ends = np.unique(free, return_inverse=True)
    ends = ends.reshape(free.shape)
    place = mesh.vertices[vertices]
    start, along = place[ends[:, 0]], place[ends[:, 1]] - place[ends[:, 0]]
    length = np.linalg.norm(along, axis=1)
    short = ends[length <= WELD_DISTANCE]
    graph = coo_matrix((np.ones(len(short)), (short[:, 0], short[:, 1])), (len(vertices), len(vertices)))
    _, group = connected_components(graph, directed=False)
    near = KDTree(place).query_ball_point(start + along / 2, length / 2 + WELD_DISTANCE)
    edge = np.repeat(np.arange(len(free)), [len(found) for found in near])
    vertex = np.concatenate([np.asarray(found, dtype=np.int64) for found in near]) if len(free) else edge
    other = (group[vertex] != group[ends[edge, 0]]) & (group[vertex] != group[ends[edge, 1]])
    edge, vertex = edge[other], vertex[other]
    apart = place[vertex] - start[edge]
    share = np.clip((apart * along[edge]).sum(axis=1) / length[edge] ** 2, 0.0, 1.0)
    beside = np.linalg.norm(apart - share[:, None] * along[edge], axis=1)
    return bool((beside < WELD_DISTANCE).any())


def _weld(mesh: Mesh, edges: Topology, reported: list[str]) -> tuple[Mesh, Topology]:
    """Join free vertices that lie closer than the weld distance; facets that become a line are dropped."""
    free = np.unique(edges.vertices[edges.free])
    pairs = KDTree(mesh.vertices[free]).query_pairs(WELD_DISTANCE, output_type="ndarray")
    if len(pairs) == 0:
        return mesh, edges
    ones = np.ones(len(pairs))
    _, label = connected_components(coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), (len(free), len(free))), False)
    first = np.full(label.max() + 1, -1)
    first[label[::-1]] = free[::-1]
    renamed = np.arange(len(mesh.vertices))
    renamed[free] = first[label]
    faces = renamed[mesh.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    moved = int(np.count_nonzero(renamed != np.arange(len(renamed))))
    where = place_text(mesh.vertices[free[pairs[0, 0]]])
    reported.append(f"repaired: {moved} vertices along cracks were joined, the first at {where}")
    welded = Mesh(mesh.vertices, faces[whole])
    return welded, topology(welded)


def _stitch(mesh: Mesh, edges: Topology, reported: list[str]) -> tuple[Mesh, Topology]:
    """Cut free edges at the free vertices that lie on them: faces of a CAD file that were meshed one by one.

    Their common edges have the same shape but different points; with the points of both sides they match.
    """
    free = edges.free
    tree = KDTree(mesh.vertices[np.unique(edges.vertices[free])])
    candidates = np.unique(edges.vertices[free])
    start, end = (mesh.vertices[edges.vertices[free, k]] for k in range(2))
    length = np.linalg.norm(end - start, axis=1)
    near = tree.query_ball_point((start + end) / 2, length / 2 + WELD_DISTANCE)
    added: list[Indices] = []
    cut: set[int] = set()
    for k, found in enumerate(near):
        facet = int(edges.facets[free[k], 0])
        points = candidates[np.asarray(found, dtype=np.int64)]
        along = (mesh.vertices[points] - start[k]) @ (end[k] - start[k]) / length[k]
        beside = np.linalg.norm(
            mesh.vertices[points] - start[k] - (along / length[k])[:, None] * (end[k] - start[k]), axis=1
        )
        on_edge = (beside < WELD_DISTANCE) & (along > MERGED) & (along < length[k] - MERGED)
        if facet in cut or not on_edge.any():
            continue
        cut.add(facet)
        order = points[on_edge][np.argsort(along[on_edge])]
        low, high = edges.vertices[free[k]]
        if not edges.forward[free[k]]:
            low, high, order = high, low, order[::-1]
        opposite = next(v for v in mesh.faces[facet] if v not in (low, high))
        line = np.concatenate([[low], order, [high]])
        fan = np.column_stack([line[:-1], line[1:], np.full(len(line) - 1, opposite)])
        added.append(fan[(fan[:, 0] != opposite) & (fan[:, 1] != opposite)])
    if not cut:
        return mesh, edges
    where = place_text(mesh.vertices[mesh.faces[min(cut)]].mean(axis=0))
    reported.append(
        f"repaired: {len(cut)} facets along open seams were cut to fit their neighbours, the first at {where}"
    )
    kept = np.delete(mesh.faces, sorted(cut), axis=0)
    return _weld_quietly(Mesh(mesh.vertices, np.vstack([kept, *added])))


def _weld_quietly(mesh: Mesh) -> tuple[Mesh, Topology]:
    return _weld(mesh, topology(mesh), [])


def _drop_duplicates(mesh: Mesh, edges: Topology, reported: list[str]) -> tuple[Mesh, Topology]:
    """Keep one of the facets that have the same three vertices, whichever way round."""
    _, first = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_index=True)
    if len(first) == len(mesh.faces):
        return mesh, edges
    dropped = np.setdiff1d(np.arange(len(mesh.faces)), first)
    where = place_text(mesh.vertices[mesh.faces[dropped[0]]].mean(axis=0))
    reported.append(f"repaired: {len(dropped)} duplicate facets were removed, the first at {where}")
    single = Mesh(mesh.vertices, mesh.faces[np.sort(first)])
    return single, topology(single)


def _orient(mesh: Mesh, edges: Topology, reported: list[str]) -> tuple[Mesh, Topology]:
    """Turn facets so that neighbours agree and the larger area of every component looks up.

    Every facet stands twice in a graph, as it is and turned; agreeing neighbours are joined alike, contradicting ones
    crosswise. A component that holds a facet in both ways is one-sided and stays as it is.
    """
    count = len(mesh.faces)
    pair = edges.facets[edges.count == 2]
    turned = (edges.forward[edges.count == 2] != 1).astype(np.int64)
    a = np.concatenate([pair[:, 0], pair[:, 0] + count])
    b = np.concatenate([pair[:, 1] + turned * count, pair[:, 1] + (1 - turned) * count])
    parts, label = connected_components(coo_matrix((np.ones(len(a)), (a, b)), (2 * count, 2 * count)), directed=False)
    corners = mesh.corners()
    projected = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    upward = np.bincount(label, weights=np.concatenate([projected, -projected]), minlength=parts)
    as_is, turned_round = label[:count], label[count:]
    flip = (upward[turned_round] > upward[as_is]) & (as_is != turned_round)
    if not flip.any():
        return mesh, edges
    faces = mesh.faces.copy()
    faces[flip] = faces[flip][:, ::-1]
    where = place_text(corners[np.argmax(flip)].mean(axis=0))
    reported.append(f"repaired: {np.count_nonzero(flip)} facets were turned to face up, the first at {where}")
    oriented = Mesh(mesh.vertices, faces)
    return oriented, topology(oriented)


def _fill_holes(mesh: Mesh, edges: Topology, widest: float, reported: list[str]) -> Mesh:
    """Close all free loops but the largest by facets between their points, seen from above."""
    loops = sorted(edges.free_loops(), key=lambda loop: -float(np.ptp(mesh.vertices[loop, :2], axis=0).max()))
    following = dict(_free_directions(mesh, edges))
    faces = [mesh.faces]
    for loop in loops[1:]:
        rim = mesh.vertices[loop]
        width = float(np.ptp(rim, axis=0).max())
        ring = _in_order(loop, following)
        added = _triangles(mesh.vertices, ring) if ring is not None and width <= widest else None
        if added is None:
            continue
        faces.append(added)
        reported.append(
            f"repaired: a hole {width * 1e3:.2f} mm wide at {place_text(rim.mean(axis=0))} was closed by {len(added)} "
            "plane facets"
        )
    return Mesh(mesh.vertices, np.vstack(faces)) if len(faces) > 1 else mesh


def _free_directions(mesh: Mesh, edges: Topology) -> list[tuple[int, int]]:
    """From-to vertex pairs of the free edges as their facets run through them."""
    pairs = []
    for edge in edges.free:
        low, high = edges.vertices[edge]
        pairs.append((int(low), int(high)) if edges.forward[edge] else (int(high), int(low)))
    return pairs


def _in_order(loop: Indices, following: dict[int, int]) -> Indices | None:
    """The vertices of a free loop one after the other, or None when it is no simple ring."""
    ring = [int(loop[0])]
    while (after := following.get(ring[-1], -1)) != ring[0]:
        if after < 0 or len(ring) > len(loop):
            return None
        ring.append(after)
    return np.array(ring) if len(ring) == len(loop) else None


def _triangles(vertices: Array, ring: Indices) -> Indices | None:
    """(K, 3) facets that look up and cover the ring seen from above, or None when they cannot."""
    outline = shapely.Polygon(vertices[ring, :2])
    if not outline.is_valid or outline.area <= 0.0:
        return None
    # the plain triangulation of older versions of shapely covers no more than rings that are nearly convex
    triangulate = getattr(shapely, "constrained_delaunay_triangles", shapely.delaunay_triangles)
    pieces = [piece for piece in triangulate(outline).geoms if outline.contains(piece.centroid)]
    if not np.isclose(sum(piece.area for piece in pieces), outline.area, rtol=1e-6):
        return None
    corners = np.array([piece.exterior.coords[:3] for piece in pieces])
    number = ring[KDTree(vertices[ring, :2]).query(corners.reshape(-1, 2))[1]].reshape(-1, 3)
    a, b, c = (vertices[number[:, k], :2] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    number[area < 0] = number[area < 0][:, ::-1]
    return np.asarray(number)
