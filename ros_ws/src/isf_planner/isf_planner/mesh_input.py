"""Reading the CAD surface: STL, OBJ, PLY or OFF with a declared unit, to a clean mesh in metres.

Nothing is guessed and nothing is repaired that changes the shape: vertices that coincide are merged, facets
without an area are dropped. What the mesh must be beyond that is checked by :mod:`isf_planner.mesh_checks`.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FORMATS = ("stl", "obj", "ply", "off")

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 25.4e-3}

MERGE_DISTANCE = 1e-7
"""m; vertices this close are one: far below any facet, far above the rounding of single precision in mm."""

_STL_HEADER, _STL_FACET = 84, 50


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes
    ----------
    vertices : (V, 3) m ; faces : (F, 3) indices, counter-clockwise seen from outside
    """

    vertices: Array
    faces: Indices

    def corners(self) -> Array:
        """(F, 3, 3) m, corner points of every facet."""
        return self.vertices[self.faces]

    def moved(self, offset: Array) -> Mesh:
        """The mesh shifted by ``offset`` (3,) m."""
        return Mesh(self.vertices + offset, self.faces)


def load_mesh(path: Path, unit: str) -> Mesh:
    """Mesh of the file at ``path``, whose coordinates are in ``unit`` ("m", "cm", "mm" or "in").

    Raises
    ------
    IsfError : MESH_UNREADABLE (missing, unknown format, damaged), MESH_EMPTY (no facets),
        MESH_NOT_FINITE (a vertex is NaN or infinite)
    """
    kind = path.suffix.lower().lstrip(".")
    where = str(path)
    if kind not in FORMATS:
        advice = f"export the surface as one of {', '.join(FORMATS)}"
        raise IsfError(ErrorCode.MESH_UNREADABLE, f"'{path.suffix}' is not a mesh format", where=where, advice=advice)
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        advice = "part.mesh is relative to the job file"
        raise IsfError(ErrorCode.MESH_UNREADABLE, "no such file", where=where, advice=advice) from error
    except OSError as error:
        raise IsfError(ErrorCode.MESH_UNREADABLE, f"cannot be read: {error.strerror}", where=where) from error
    if not data:
        raise IsfError(ErrorCode.MESH_EMPTY, "the file is empty", where=where, advice="export the surface again")
    vertices, faces = _parse(data, kind, where)
    if len(faces) == 0:
        advice = "export the surface as triangles, and check that the file was written completely"
        raise IsfError(ErrorCode.MESH_EMPTY, "there are no facets in the file", where=where, advice=advice)
    _check_finite(vertices, faces, where)
    return _clean(vertices * METRES[unit], faces, where)


def _parse(data: bytes, kind: str, where: str) -> tuple[Array, Indices]:
    """Vertices and faces as they are in the file; every way a parser can fail becomes MESH_UNREADABLE."""
    if kind == "stl":
        _check_stl_length(data, where)
    try:
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False)
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # the parsers raise whatever the damage makes them stumble over
        advice = "export the surface again, as binary STL for example"
        raise IsfError(
            ErrorCode.MESH_UNREADABLE, f"is not a valid {kind.upper()} file", where=where, advice=advice
        ) from error
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise IsfError(ErrorCode.MESH_UNREADABLE, "a facet refers to a vertex that is not in the file", where=where)
    return vertices, faces


def _check_stl_length(data: bytes, where: str) -> None:
    """A binary STL whose header promises more facets than follow ends early; its rest must not be formed."""
    if data[:5].lower() == b"solid" or len(data) < _STL_HEADER:
        return
    (count,) = struct.unpack("<I", data[80:_STL_HEADER])
    present = (len(data) - _STL_HEADER) // _STL_FACET
    is_text = not any(byte > 127 or byte == 0 for byte in data[:_STL_HEADER])
    if count > present and not is_text:
        raise IsfError(
            ErrorCode.MESH_UNREADABLE,
            f"the file ends early: {present} of {count} facets",
            where=where,
            advice="copy or export the file again",
        )


def _check_finite(vertices: Array, faces: Indices, where: str) -> None:
    used = np.unique(faces)
    bad = used[~np.isfinite(vertices[used]).all(axis=1)]
    if len(bad):
        facet = int(np.argmax((faces == bad[0]).any(axis=1)))
        raise IsfError(
            ErrorCode.MESH_NOT_FINITE,
            f"{len(bad)} vertices are not numbers, the first belongs to facet {facet}",
            where=where,
            advice="export the surface again",
        )


def _clean(vertices: Array, faces: Indices, where: str) -> Mesh:
    """Merge coinciding vertices, drop facets without area and vertices without a facet."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(digits_vertex=round(-np.log10(MERGE_DISTANCE)), merge_tex=True, merge_norm=True)
    points = np.asarray(mesh.vertices, dtype=np.float64)
    kept = np.asarray(mesh.faces, dtype=np.int64)
    corners = points[kept]
    double_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    kept = kept[double_area > MERGE_DISTANCE**2]
    if len(kept) == 0:
        raise IsfError(ErrorCode.MESH_EMPTY, "no facet has an area", where=where, advice="check the unit: part.unit")
    used, renumbered = np.unique(kept, return_inverse=True)
    return Mesh(points[used], renumbered.reshape(kept.shape).astype(np.int64))
