"""Compile the shell's kernels once, so that the first correction does not wait: ``python -m ...shell.warm_up``."""

from __future__ import annotations

import sys
import time

import numpy as np

from isf_springback.shell.load_path import follow_load
from isf_springback.shell.plan_mesh import mesh_in_plan
from isf_springback.shell.sheet_model import EdgeCondition, SheetMesh, ShellModel


def warm_up() -> float:
    """Push a coarse plate; returns the wall time, s. Kernels found in the cache cost little."""
    started = time.perf_counter()
    outline = 0.05 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    points, triangles, edge = mesh_in_plan(outline, np.zeros((1, 2)), lambda places: np.full(len(places), 20e-3))
    mesh = SheetMesh(np.column_stack([points, np.zeros(len(points))]), triangles, edge, np.array([0]))
    model = ShellModel(mesh, np.full(len(triangles), 1e-3), 70e9, 0.33, EdgeCondition())
    follow_load(model, 0, np.array([0.0, 0.0, -1.0]), np.array([10.0, 20.0]), model.factor())
    return time.perf_counter() - started


if __name__ == "__main__":
    print(f"kernels of the elastic shell ready in {warm_up():.1f} s", file=sys.stderr)
