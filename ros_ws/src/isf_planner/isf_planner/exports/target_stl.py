"""Shapes as STL files in mm, frame ``sheet``: the target as it is planned (the part, or the part moved by accuracy
surfaces), and what is formed before it."""

from __future__ import annotations

from pathlib import Path

import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap

from isf_planner.part.meshes import Mesh
from isf_planner.part_plan import Plan
from isf_planner.surface.height_grid import as_mesh


def write_target(plan: Plan, path: Path) -> Path:
    """Binary STL of the target; raises IsfError FILE_NOT_WRITABLE."""
    return _write(plan.moved.moved if plan.moved else Mesh(*plan.mesh), path)


def write_shape(heights: HeightMap, path: Path) -> Path:
    """Binary STL of a surface over a grid, two facets per cell; raises IsfError FILE_NOT_WRITABLE."""
    return _write(as_mesh(heights), path)


def _write(mesh: Mesh, path: Path) -> Path:
    try:
        trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(path, file_type="stl")
    except OSError as error:
        what = f"cannot be written: {error.strerror}"
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, what, where=str(path), advice="check folder and disk") from error
    return path
