"""Meshes of parts: the CAD surface read from its file, in metres, and the edges of its facets.

STL, OBJ, PLY, OFF, 3MF, STEP or IGES. Nothing is guessed: a format that carries no unit needs a declared one, and a
declared unit that contradicts the file is an error. Binary STL files are told from text ones by their length and not
by their first word. Vertices that coincide are merged, facets without an area are dropped. What the mesh must be
beyond that is checked, and what can be repaired is repaired, in :mod:`isf_planner.part.mesh_checks`.
"""

from __future__ import annotations

import errno
import stat
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import METRES
from isf_core.files.mesh_parser import parse_mesh
from isf_core.types import Array, Indices
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from isf_planner.jit import kernel
from isf_planner.part import cad_input, mesh_kernels

FORMATS = ("stl", "obj", "ply", "off")
"""Meshes without a unit."""

MESHES_WITH_UNIT = ("3mf",)

KNOWN = (*FORMATS, *MESHES_WITH_UNIT, *cad_input.FORMATS)
"""Every format that is read."""

UNITS_3MF = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 25.4e-3, "foot": 0.3048, "meter": 1.0}

MERGE_DISTANCE = 1e-7
"""m; vertices this close are one: far below any facet, far above the rounding of single precision in mm."""


LARGEST_FILE = 500_000_000
"""bytes: ten million facets of a binary STL."""
LARGEST = 1e4
"""m; larger coordinates cannot be right in any unit, and would not be told apart at the merge distance."""


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes
    ----------
    vertices : (V, 3) m ; faces : (F, 3) indices, counter-clockwise seen from outside
    derived : what was found from the faces alone, by name; meshes with other vertices and the same faces share it
    """

    vertices: Array
    faces: Indices
    derived: dict[str, object] = field(default_factory=dict, repr=False, compare=False)

    def corners(self) -> Array:
        """(F, 3, 3) m, corner points of every facet."""
        return self.vertices[self.faces]

    def moved(self, offset: Array) -> Mesh:
        """The mesh shifted by ``offset`` (3,) m."""
        return self.with_vertices(self.vertices + offset)

    def with_vertices(self, vertices: Array) -> Mesh:
        """The mesh with its vertices elsewhere, (V, 3) m."""
        return Mesh(vertices, self.faces, self.derived)


def load_mesh(path: Path, unit: str | None) -> Mesh:
    """Mesh of the file at ``path``, whose coordinates are in ``unit`` ("m", "cm", "mm", "in"; None: the file tells).

    Raises
    ------
    IsfError : MESH_UNREADABLE (missing, unknown format, damaged, a library is missing), MESH_EMPTY (no facets),
        MESH_NOT_FINITE (a vertex is NaN or infinite), MESH_UNIT_UNKNOWN (no unit, or one that contradicts the file)
    """
    kind = path.suffix.lower().lstrip(".")
    where = str(path)
    if kind not in KNOWN:
        advice = f"export the surface as one of {', '.join(KNOWN)}"
        raise IsfError(ErrorCode.MESH_UNREADABLE, f"'{path.suffix}' is not a mesh format", where=where, advice=advice)
    if kind in FORMATS and unit is None:
        raise IsfError(
            ErrorCode.MESH_UNIT_UNKNOWN,
            f"{kind.upper()} files carry no unit",
            where=where,
            advice="declare it in the job: part.unit: mm (or m, cm, in)",
        )
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "is no file, but a folder, a pipe or a device")
        if status.st_size > LARGEST_FILE:
            raise OSError(errno.EFBIG, f"is larger than {LARGEST_FILE // 1_000_000} MB")
        data = path.read_bytes()
    except FileNotFoundError as error:
        advice = "part.mesh is relative to the job file"
        raise IsfError(ErrorCode.MESH_UNREADABLE, "no such file", where=where, advice=advice) from error
    except OSError as error:
        raise IsfError(
            ErrorCode.MESH_UNREADABLE, f"cannot be read: {error.strerror}", where=where, advice="check the path"
        ) from error
    if not data:
        raise IsfError(ErrorCode.MESH_EMPTY, "the file is empty", where=where, advice="export the surface again")
    vertices, faces, reported = _read(data, kind, where)
    if len(faces) == 0:
        advice = "export the surface as triangles, and check that the file was written completely"
        raise IsfError(ErrorCode.MESH_EMPTY, "there are no facets in the file", where=where, advice=advice)
    _check_indices(vertices, faces, where)
    _check_finite(vertices, faces, where)
    if reported is not None:
        _check_unit(unit, reported, where)
    scale = 1.0 if kind in cad_input.FORMATS else reported or METRES[unit or "m"]
    return _clean(vertices * scale, faces, where)


def _read(data: bytes, kind: str, where: str) -> tuple[Array, Indices, float | None]:
    """Vertices and faces as they are in the file (of STEP and IGES: in m), and metres per unit where the file tells."""
    if kind in cad_input.FORMATS:
        return cad_input.read(data, kind, where)
    if kind == "stl":
        facets = read_binary(data, where)
        if facets is not None:
            return facets.reshape(-1, 3), np.arange(3 * len(facets)).reshape(-1, 3), None
    return _parse(data, kind, where)


def _check_unit(unit: str | None, metres: float, where: str) -> None:
    """A declared unit must be the one of the file."""
    if unit is not None and abs(METRES[unit] / metres - 1.0) > 1e-6:
        name = next((name for name, size in METRES.items() if abs(size / metres - 1.0) < 1e-6), f"{metres:g} m")
        raise IsfError(
            ErrorCode.MESH_UNIT_UNKNOWN,
            f"the job declares {unit}, the file says that its unit is {name}",
            where=where,
            advice="leave part.unit out, or use part.scale if the file is wrong",
        )


def _parse(data: bytes, kind: str, where: str) -> tuple[Array, Indices, float | None]:
    """By trimesh; every way a parser can fail becomes MESH_UNREADABLE."""
    metres = None
    advice = "export the surface again, as binary STL for example"
    try:
        loaded = parse_mesh(data, kind, process=False)
        if kind in MESHES_WITH_UNIT:
            metres = UNITS_3MF[str(loaded.metadata.get("units", "millimeter")).rstrip("s")]
        mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), dtype=np.int64).reshape(-1, 3)
    except OSError as error:
        raise IsfError(
            ErrorCode.MESH_UNREADABLE, f"{error.strerror}", where=where, advice="export it coarser, or as binary STL"
        ) from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:  # no mesh, or arrays that belong to none
        raise IsfError(
            ErrorCode.MESH_UNREADABLE, f"is not a valid {kind.upper()} file", where=where, advice=advice
        ) from error
    return vertices, faces, metres


def _check_indices(vertices: Array, faces: Indices, where: str) -> None:
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise IsfError(
            ErrorCode.MESH_UNREADABLE,
            "a facet refers to a vertex that is not in the file",
            where=where,
            advice="export the surface again",
        )


def _check_finite(vertices: Array, faces: Indices, where: str) -> None:
    finite = np.asarray(np.isfinite(vertices).all(axis=1))
    if finite.all():
        return
    wrong = ~finite[faces].all(axis=1)
    if wrong.any():
        raise IsfError(
            ErrorCode.MESH_NOT_FINITE,
            f"the vertices of {np.count_nonzero(wrong)} facets are not numbers, the first is facet {np.argmax(wrong)}",
            where=where,
            advice="export the surface again",
        )


def _clean(vertices: Array, faces: Indices, where: str) -> Mesh:
    """Merge coinciding vertices, drop facets without area and vertices without a facet."""
    if np.abs(vertices[np.isfinite(vertices)]).max(initial=0.0) > LARGEST:
        raise IsfError(
            ErrorCode.MESH_UNIT_SUSPECT,
            f"coordinates go beyond {LARGEST:g} m",
            where=where,
            advice="check part.unit in the job",
        )
    points, kept = mesh_kernels.merge(vertices, faces, MERGE_DISTANCE)
    if len(kept) == 0:
        raise IsfError(ErrorCode.MESH_EMPTY, "no facet has an area", where=where, advice="check the unit: part.unit")
    return Mesh(points, kept)


_HEADER, _FACET = 84, 50

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_binary(data: bytes, where: str) -> Array | None:
    """(F, 3, 3) corners of a binary file in its unit; None for a text file.

    Many programs begin binary files with "solid" too: a file is binary when its length is what its count promises,
    or when its first part holds bytes that no text has.

    Raises
    ------
    IsfError : MESH_UNREADABLE for a binary file that ends early
    """
    if len(data) < _HEADER:
        return None
    (count,) = struct.unpack("<I", data[80:_HEADER])
    present = (len(data) - _HEADER) // _FACET
    if count != present or len(data) != _HEADER + _FACET * count:
        if _is_text(data[:1024]):
            return None
        if count > present:
            raise IsfError(
                ErrorCode.MESH_UNREADABLE,
                f"the file ends early: {present} of {count} facets",
                where=where,
                advice="copy or export the file again",
            )
    records = np.frombuffer(data, dtype=_RECORD, count=min(count, present), offset=_HEADER)
    return records["corners"].astype(np.float64)


def _is_text(beginning: bytes) -> bool:
    """No control characters but those of text."""
    return all(byte >= 32 or byte in (9, 10, 12, 13) for byte in beginning) and b"\x7f" not in beginning


_LONG_ROW = 48
"""Edges that start at one vertex are compared pairwise; more than this many are sorted first."""


@dataclass(frozen=True)
class Topology:
    """E edges of a mesh with F facets.

    Attributes
    ----------
    vertices : (E, 2) vertex indices, the lower first
    facets : (E, 2) the first two facets at the edge, -1 where there is none
    count : (E,) facets at the edge
    forward : (E,) how many of them run through it from the lower to the higher vertex
    """

    vertices: Indices
    facets: Indices
    count: Indices
    forward: Indices

    @property
    def free(self) -> Indices:
        """Edges of one facet only."""
        return np.flatnonzero(self.count == 1)

    @property
    def crowded(self) -> Indices:
        """Edges of three and more facets: the mesh is no surface there."""
        return np.flatnonzero(self.count > 2)

    @property
    def contradicting(self) -> Indices:
        """Edges whose two facets are oriented against each other."""
        return np.flatnonzero((self.count == 2) & (self.forward != 1))

    def free_loops(self) -> list[Indices]:
        """Vertex indices of every connected set of free edges."""
        edges = self.vertices[self.free]
        if len(edges) == 0:
            return []
        vertices, local = np.unique(edges, return_inverse=True)
        local = local.reshape(edges.shape)
        graph = coo_matrix((np.ones(len(edges)), (local[:, 0], local[:, 1])), shape=(len(vertices), len(vertices)))
        _, label = connected_components(graph, directed=False)
        order = np.argsort(label, kind="stable")
        return [vertices[part] for part in np.split(order, np.flatnonzero(np.diff(label[order])) + 1)]

    def components(self, facets: int) -> tuple[int, Indices]:
        """Number of parts that hang together by edges, and the part (F,) of every facet; ``facets``: F."""
        joined = self.facets[self.count >= 2]
        ones = np.ones(len(joined))
        return connected_components(coo_matrix((ones, (joined[:, 0], joined[:, 1])), (facets, facets)), directed=False)


def topology(mesh: Mesh) -> Topology:
    """Edges of the ``mesh``; the work grows with the number of facets and is done once for the same faces."""
    known = mesh.derived.get("topology")
    if not isinstance(known, Topology):
        known = Topology(*_edges(np.ascontiguousarray(mesh.faces), len(mesh.vertices)))
        mesh.derived["topology"] = known
    return known


@kernel
def _edges(faces: Indices, vertices: int) -> tuple[Indices, Indices, Indices, Indices]:
    begin = np.zeros(vertices + 1, dtype=np.int64)
    for f in range(len(faces)):
        for c in range(3):
            begin[min(faces[f, c], faces[f, (c + 1) % 3]) + 1] += 1
    begin = np.cumsum(begin)
    place = begin[:-1].copy()
    high = np.empty(3 * len(faces), dtype=np.int64)
    half = np.empty(3 * len(faces), dtype=np.int64)
    for f in range(len(faces)):
        for c in range(3):
            p, q = faces[f, c], faces[f, (c + 1) % 3]
            slot = place[min(p, q)]
            place[min(p, q)] += 1
            high[slot], half[slot] = max(p, q), 3 * f + c
    pairs = np.empty((3 * len(faces), 2), dtype=np.int64)
    facets = np.full((3 * len(faces), 2), -1, dtype=np.int64)
    count = np.zeros(3 * len(faces), dtype=np.int64)
    forward = np.zeros(3 * len(faces), dtype=np.int64)
    edges = 0
    for low in range(vertices):
        first, last = begin[low], begin[low + 1]
        if last - first > _LONG_ROW:
            order = np.argsort(high[first:last])
            high[first:last] = high[first:last][order]
            half[first:last] = half[first:last][order]
        base = edges
        for slot in range(first, last):
            edge = -1
            start = max(base, edges - 1) if last - first > _LONG_ROW else base
            for other in range(start, edges):
                if pairs[other, 1] == high[slot]:
                    edge = other
                    break
            if edge < 0:
                edge = edges
                edges += 1
                pairs[edge, 0], pairs[edge, 1] = low, high[slot]
            f, c = half[slot] // 3, half[slot] % 3
            if count[edge] < 2:
                facets[edge, count[edge]] = f
            count[edge] += 1
            if faces[f, c] == low:
                forward[edge] += 1
    return pairs[:edges].copy(), facets[:edges].copy(), count[:edges].copy(), forward[:edges].copy()
