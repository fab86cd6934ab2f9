"""Reading the CAD surface: STL, OBJ, PLY, OFF, 3MF, STEP or IGES, to a clean mesh in metres.

Nothing is guessed: a format that carries no unit needs a declared one, and a declared unit that contradicts the file
is an error. Vertices that coincide are merged, facets without an area are dropped. What the mesh must be beyond that
is checked by :mod:`isf_planner.mesh_checks`; what can be repaired is in :mod:`isf_planner.mesh_repair`.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.job_part import METRES
from numpy.typing import NDArray

from isf_planner import cad_input, mesh_kernels, stl_file

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FORMATS = ("stl", "obj", "ply", "off")
"""Meshes without a unit."""

MESHES_WITH_UNIT = ("3mf",)

KNOWN = (*FORMATS, *MESHES_WITH_UNIT, *cad_input.FORMATS)
"""Every format that is read."""

UNITS_3MF = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 25.4e-3, "foot": 0.3048, "meter": 1.0}

MERGE_DISTANCE = 1e-7
"""m; vertices this close are one: far below any facet, far above the rounding of single precision in mm."""


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
    vertices, faces, told = _read(data, kind, where)
    if len(faces) == 0:
        advice = "export the surface as triangles, and check that the file was written completely"
        raise IsfError(ErrorCode.MESH_EMPTY, "there are no facets in the file", where=where, advice=advice)
    _check_indices(vertices, faces, where)
    _check_finite(vertices, faces, where)
    if told is not None:
        _check_unit(unit, told, where)
    scale = 1.0 if kind in cad_input.FORMATS else told or METRES[unit or "m"]
    return _clean(vertices * scale, faces, where)


def _read(data: bytes, kind: str, where: str) -> tuple[Array, Indices, float | None]:
    """Vertices and faces as they are in the file (of STEP and IGES: in m), and metres per unit where the file tells."""
    if kind in cad_input.FORMATS:
        return cad_input.read(data, kind, where)
    if kind == "stl":
        facets = stl_file.read_binary(data, where)
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
    try:
        loaded = trimesh.load(io.BytesIO(data), file_type=kind, process=False)
        if kind in MESHES_WITH_UNIT:
            metres = UNITS_3MF[str(loaded.metadata.get("units", "millimeter")).rstrip("s")]
        mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), dtype=np.int64).reshape(-1, 3)
    except MemoryError:
        raise
    except Exception as error:  # the parsers raise whatever the damage makes them stumble over
        advice = "export the surface again, as binary STL for example"
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
