"""A job for a rig alone: what identification forms when no part is named.

A cone of 45 deg, 5 mm deep, in 1 mm of AA5754-O with balls of 5 mm radius: walls in all directions and a flat middle,
small enough for every rig's travel. The choice is ours; the compliances that are found do not depend on it, the contact
stiffness does (wall angle, sheet and balls), so for that a job of one's own says more.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from isf_core.files.job import JobFile
from isf_core.files.yaml_file import find_named
from isf_planner.part_library import PARTS, part_mesh

_JOB = """\
name: identification
part: {{mesh: identification.stl, unit: mm}}
process: DSIF
rig: {rig}
sheet: {{material: AA5754-O, thickness: 1.0 mm}}
tool_1: {{radius: 5 mm}}
tool_2: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
control: {{support_force: 120 N, engage_depth: 2 mm}}
springback: {{method: none}}
"""


def rig_job(rig: str, folder: Path) -> JobFile:
    """Job on ``rig`` (a name, or a file relative to the present folder), its mesh written to ``folder``.

    Raises IsfError for the rig.
    """
    part = part_mesh(PARTS["cone"](radius=0.016, angle=np.pi / 4.0, depth=0.005, entry=0.004, floor=0.004))
    trimesh.Trimesh(part.vertices * 1e3, part.faces, process=False).export(folder / "identification.stl")
    return JobFile(_JOB.format(rig=rig_name(rig)), folder, "the job of --rig")


def rig_name(rig: str) -> str:
    """``rig`` as a rig file may be based on it from anywhere: its name, or the absolute path of its file."""
    path = find_named("rigs", rig, Path.cwd())
    return str(path.resolve()) if rig.endswith((".yaml", ".yml")) else rig
