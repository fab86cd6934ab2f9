"""The part of a fault campaign: a flat cone in three quick contours, with the tools parked near the sheet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_planner.part_library import PARTS, part_mesh

JOB_FILE = "job.yaml"
JOB = """\
name: fault_cone
part:
  mesh: cone.stl
  unit: mm
process: DSIF
rig: rig.yaml
sheet:
  material: AA5754-O
  thickness: 1.0 mm
tool_1:
  radius: 5 mm
tool_2:
  radius: 5 mm
path:
  incremental_depth: 1 mm
  point_spacing: 1 mm
  feed: 20 mm/s
control:
  rate: 100 Hz
  support_force: 120 N
  engage_depth: 1 mm
springback:
  method: analytic
"""
RIG = """\
based_on: ren2018
name: near
park_height: 15 mm
"""


def write_part(folder: Path) -> JobFile:
    """Mesh, rig and job in ``folder``; raises IsfError FILE_NOT_WRITABLE."""
    part = PARTS["cone"](radius=0.016, depth=0.003, entry=0.003, floor=0.006, angle=np.radians(40.0))
    mesh = part_mesh(part)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces, process=False).export(folder / "cone.stl")
        (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
        (folder / JOB_FILE).write_text(JOB, encoding="utf-8")
    except OSError as error:
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(folder)) from error
    return JobFile(JOB, folder, "job of the campaign")
