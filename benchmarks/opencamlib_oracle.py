#!/usr/bin/env python3
"""Tool positions of the planner against opencamlib, an independent CAM library, on three parts.

opencamlib has wheels for CPython up to 3.11 only and is no requirement of this project. Give it an environment of its
own outside the repository; the two sides meet in plan files.

    . .isf/env.sh && python benchmarks/opencamlib_oracle.py make /tmp/oracle
    python3.11 -m venv /tmp/ocl && /tmp/ocl/bin/pip install opencamlib numpy
    /tmp/ocl/bin/python benchmarks/opencamlib_oracle.py compare /tmp/oracle

drop: the ball is dropped on the same facets at x and y of every planned tip; difference of heights times the cosine of
the wall angle, the distance along the normal. waterline: distance of the planned tips from opencamlib's waterline at
the same level, in the plane. Exit code 1 when a distance exceeds 20 um.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

PARTS = ("cone", "pyramid", "heart")
RADIUS = 5.0
TOLERANCE = 0.020
WATERLINE_SAMPLING = 0.5
"""mm, distance of opencamlib's fibres: chords then stay within 3 um of a line of 12 mm radius."""
MM = 1e3

JOB = """\
name: {name}
part: {{mesh: {name}.stl, unit: mm}}
process: SPIF
rig: ren2018
sheet: {{material: AA5754-O, thickness: 1.0 mm}}
tool_1: {{radius: 5 mm}}
path: {{incremental_depth: 1 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
"""


def make(folder: Path) -> None:
    """Plan the parts and write the plan files."""
    import trimesh
    from isf_core.files.job import JobFile
    from isf_planner import plan
    from isf_planner.exports import save_plan
    from isf_planner.part_library import PARTS as LIBRARY
    from isf_planner.part_library import part_mesh

    folder.mkdir(parents=True, exist_ok=True)
    for name in PARTS:
        mesh = part_mesh(LIBRARY[name]())
        trimesh.Trimesh(mesh.vertices * MM, mesh.faces, process=False).export(folder / f"{name}.stl")
        print(save_plan(plan(JobFile(JOB.format(name=name), folder)), folder / f"{name}.npz"))


def compare(folder: Path) -> int:
    """Compare the plans in ``folder`` with opencamlib."""
    try:
        import opencamlib as ocl
    except ImportError:
        print("skipped: opencamlib is not installed for this interpreter (it has wheels up to CPython 3.11)")
        return 0
    worst = 0.0
    print("| part | tips | drop: largest, 99 % (um) | waterline: levels, largest, 99 % (um) |\n|---|---|---|---|")
    for name in PARTS:
        tips, levels, vertices, faces, cosine = _read(folder / f"{name}.npz")
        surface = ocl.STLSurf()
        for corners in vertices[faces]:
            surface.addTriangle(ocl.Triangle(*(ocl.Point(*corner) for corner in corners.tolist())))
        drop = np.abs(_dropped(ocl, surface, tips, float(vertices[:, 2].min()) - 1.0) - tips[:, 2]) * cosine
        chosen = levels[3:-1:6]
        line = np.concatenate([_waterline_distance(ocl, surface, tips, level) for level in chosen])
        worst = max(worst, float(drop.max()), float(line.max()))
        print(
            f"| {name} | {len(tips)} | {drop.max() * MM:.2f}, {np.percentile(drop, 99) * MM:.2f} "
            f"| {len(chosen)}, {line.max() * MM:.2f}, {np.percentile(line, 99) * MM:.2f} |"
        )
    print(f"largest {worst * MM:.2f} um, {'within' if worst <= TOLERANCE else 'BEYOND'} {TOLERANCE * MM:.0f} um")
    return int(worst > TOLERANCE)


def _read(path: Path) -> tuple[Any, ...]:
    """Tips (N, 3) mm, levels mm, mesh vertices mm and faces, cosine of the wall angle (N,)."""
    with np.load(path) as data:
        tips = data["contour_forming_tip"].reshape(-1, 3) * MM
        normal = data["contour_normal"].reshape(-1, 3)
        assert json.loads(str(data["head"]))["format"] == "isf plan"
        levels = np.unique(np.round(tips[:, 2], 6))[::-1]
        return tips, levels, data["mesh_vertices"] * MM, data["mesh_faces"], normal[:, 2]


def _dropped(ocl: Any, surface: Any, tips: Any, floor: float) -> Any:
    drop = ocl.BatchDropCutter()
    drop.setSTL(surface)
    drop.setCutter(ocl.BallCutter(2 * RADIUS, 100.0))
    for x, y, _ in tips.tolist():
        drop.appendPoint(ocl.CLPoint(x, y, floor))
    drop.run()
    return np.array([point.z for point in drop.getCLPoints()])


def _waterline_distance(ocl: Any, surface: Any, tips: Any, level: float) -> Any:
    """(n,) mm, from the tips at ``level`` to the nearest chord of the waterline there."""
    water = ocl.Waterline()
    water.setSTL(surface)
    water.setCutter(ocl.BallCutter(2 * RADIUS, 100.0))
    water.setZ(level)
    water.setSampling(WATERLINE_SAMPLING)
    water.run()
    loops = [np.array([[point.x, point.y] for point in loop]) for loop in water.getLoops()]
    mine = tips[np.abs(tips[:, 2] - level) < 1e-6][:, :2]
    nearest = np.full(len(mine), np.inf)
    for loop in loops:
        start, way = loop, np.roll(loop, -1, axis=0) - loop
        length = np.maximum((way**2).sum(axis=1), 1e-18)
        for k, point in enumerate(mine):
            share = np.clip(((point - start) * way).sum(axis=1) / length, 0.0, 1.0)
            nearest[k] = min(nearest[k], np.linalg.norm(start + share[:, None] * way - point, axis=1).min())
    return nearest


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=["make", "compare"])
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    if arguments.step == "make":
        make(arguments.folder)
        return 0
    return compare(arguments.folder)


if __name__ == "__main__":
    sys.exit(main())
