"""The formed shape as files for other programs: STL, PLY and VTK, in mm, in the frame ``sheet``.

The upper surface of the sheet as it was scanned, two triangles for every cell whose four corners were measured. PLY and
VTK carry numbers at every point: the deviation, where the report has one, and the thickness of the plan where something
was formed (in the last stage).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array, Indices
from isf_core.view.coloured import near_path

from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import deviation_of
from isf_analysis.measures.surface_distance import Surface

MM = 1e3
TRIANGLE = 5
"""Number of the cell in files of VTK."""


def write_shape(record: PartRecord, folder: Path) -> tuple[Path, ...]:
    """Write ``formed.stl``, ``formed.ply`` and ``formed.vtk`` into ``folder``, which is made when it does not exist.

    Raises
    ------
    IsfError : BAG_INCOMPLETE when the part was not scanned, or no cell of the scan is whole ; FILE_NOT_WRITABLE
    """
    scan = record.scan
    if scan is None:
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            "the formed shape was not scanned: there is nothing to export",
            where="topic scan",
            advice="scan the part after its last contour",
        )
    try:
        surface = Surface.of_height_map(scan)
    except IsfError as failure:
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            "no cell of the scan is whole: there is nothing to export",
            where="topic scan",
            advice="scan the part again",
        ) from failure
    used, local = np.unique(surface.faces, return_inverse=True)  # points that were not measured are left out
    points, faces = surface.vertices[used], local.reshape(-1, 3)
    values: dict[str, Array] = {}
    if record.target is not None and _compared(record):
        error = points[:, 2] - record.target.at(points[:, :2])
        values["deviation_mm"] = (MM * error).astype(np.float32)
    if formed := record.last_stage:
        thickness = near_path(formed, [contour.thickness for contour in formed], scan.x, scan.y)
        values["planned_thickness_mm"] = (MM * thickness.ravel()[used]).astype(np.float32)
    vertices = MM * points
    mesh = trimesh.Trimesh(vertices, faces, process=False, vertex_attributes=values)
    written = {
        "formed.stl": mesh.export(file_type="stl"),
        "formed.ply": mesh.export(file_type="ply"),
        "formed.vtk": _vtk(vertices, faces, values, record.job_name),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in written.items():
            (folder / name).write_bytes(content)
    except OSError as error:
        what = f"the shape cannot be written: {error.strerror}"
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, what, where=str(folder), advice="choose a writable folder"
        ) from error
    return tuple(folder / name for name in written)


def _compared(record: PartRecord) -> bool:
    """Whether the report compares scan and target: they go together."""
    try:
        return deviation_of(record) is not None
    except IsfError:
        return False


def _vtk(vertices: Array, faces: Indices, values: dict[str, Array], title: str) -> bytes:
    """Legacy file of VTK, version 3.0, binary (big endian): triangles with numbers at their points."""
    rows = np.column_stack([np.full(len(faces), 3), faces]).astype(">i4")
    parts = [
        f"# vtk DataFile Version 3.0\n{title[:200]}, formed shape, mm\nBINARY\nDATASET UNSTRUCTURED_GRID\n".encode(),
        f"POINTS {len(vertices)} double\n".encode() + vertices.astype(">f8").tobytes(),
        f"\nCELLS {len(rows)} {rows.size}\n".encode() + rows.tobytes(),
        f"\nCELL_TYPES {len(rows)}\n".encode() + np.full(len(rows), TRIANGLE, dtype=">i4").tobytes() + b"\n",
    ]
    if values:
        parts.append(f"POINT_DATA {len(vertices)}\n".encode())
    for name, column in values.items():
        head = f"SCALARS {name} float 1\nLOOKUP_TABLE default\n"
        parts.append(head.encode() + column.astype(">f4").tobytes() + b"\n")
    return b"".join(parts)
