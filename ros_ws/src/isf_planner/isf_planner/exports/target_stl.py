"""The target as it is planned, as an STL file: the part, or the part moved by accuracy surfaces."""

from __future__ import annotations

from pathlib import Path

import trimesh
from isf_core.errors import ErrorCode, IsfError

from isf_planner.part_plan import Plan


def write_target(plan: Plan, path: Path) -> Path:
    """Binary STL in mm, frame ``sheet``; raises IsfError FILE_NOT_WRITABLE."""
    vertices, faces = (plan.moved.moved.vertices, plan.moved.moved.faces) if plan.moved else plan.mesh
    try:
        trimesh.Trimesh(1e3 * vertices, faces, process=False).export(path, file_type="stl")
    except OSError as error:
        what = f"cannot be written: {error.strerror}"
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, what, where=str(path), advice="check folder and disk") from error
    return path
