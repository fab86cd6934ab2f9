"""Compile the planner's kernels once, so that the first plan starts at once: ``python -m isf_planner.warm_up``."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh
from isf_core.files.job import JobFile

from isf_planner.forming import carried_sheet
from isf_planner.planning import plan, replan
from isf_planner.surface import surface_kernels

_JOB = """
name: warm-up
part: {mesh: part.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 1 mm, point_spacing: 1 mm, feed: 30 mm/s, spacing: arc, arc_step: 1 mm}
"""


def warm_up() -> float:
    """Plan a small round pocket; returns the wall time, s. Kernels found in the cache cost little."""
    started = time.perf_counter()
    x = np.linspace(-30.0, 30.0, 61)
    gx, gy = np.meshgrid(x, x)
    share = np.clip((np.hypot(gx, gy) - 8.0) / 16.0, 0.0, 1.0)
    node = np.arange(61 * 61).reshape(61, 61)
    a, b, c, d = (node[i : 60 + i, j : 60 + j].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
    vertices = np.column_stack([gx.ravel(), gy.ravel(), -2.0 * (1.0 + np.cos(np.pi * share)).ravel()])
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    with tempfile.TemporaryDirectory() as folder:
        trimesh.Trimesh(vertices, faces, process=False).export(Path(folder) / "part.stl")
        job_file = JobFile(_JOB, Path(folder))
        replan(plan(job_file), job_file)
    surface_kernels.hung(np.zeros((3, 3)), 1.0)  # of a part in stages alone, as is the next
    points, surface = np.zeros((1, 3)), np.zeros((3, 3))
    carried_sheet.push(points, points.copy(), surface, np.zeros(2), 1.0, 0.0, 0.0, np.zeros(1))
    return time.perf_counter() - started


if __name__ == "__main__":
    print(f"kernels of the planner ready in {warm_up():.1f} s", file=sys.stderr)
