"""The elastic shell against CalculiX S6 (six-node shells, large rotations) on the same sheets: deflection and time.

usage: python benchmarks/shell_oracle.py [cone45 cone50 flat]      needs ccx (Debian: apt install calculix-ccx)

The S6 mesh is twice as fine at the load (on our own mesh S6 is 3 to 5 % stiffer). Clamped edge, free in its
plane; 1 mm sheet, E 70 GPa, nu 0.33; one node loaded downwards with 200 and 600 N.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from isf_core.contour import Contour, Process
from isf_core.types import Array
from isf_springback.shell.formed_sheet import FacetSize, formed_sheet, mesh_of
from isf_springback.shell.load_path import follow_load
from isf_springback.shell.plan_mesh import mesh_in_plan
from isf_springback.shell.sheet_model import EdgeCondition, SheetMesh, ShellModel, held_freedoms, sine_law_thickness

YOUNG, POISSON, THICKNESS = 70e9, 0.33, 1e-3
LOADS = np.array([100.0, 200.0, 400.0, 600.0])
SHOWN = (1, 3)
CLAMP = (0.25, 0.25)


def cone(angle: float, opening: float = 40e-3, depth: float = 21e-3) -> list[Contour]:
    """Contours of a straight cone, ``angle`` deg, a millimetre apart."""
    wall, loops = np.radians(angle), []
    for index in range(round(depth / 1e-3)):
        z = 1e-3 * (index + 1)
        radius = opening - z / np.tan(wall)
        turn = (
            2
            * np.pi
            * np.arange(max(40, round(2 * np.pi * radius / 0.5e-3)))
            / max(40, round(2 * np.pi * radius / 0.5e-3))
        )
        out = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))])
        contact = radius * out - [0.0, 0.0, z]
        normal = -np.sin(wall) * out + [0.0, 0.0, np.cos(wall)]
        n = len(turn)
        loops.append(
            Contour(
                "cone", index, 99, Process.SPIF, 0.03, contact, normal, np.full(n, wall), np.full(n, THICKNESS), contact
            )
        )
    return loops


FINE = FacetSize(1.5e-3, 4e-3, 10e-3, 0.15, 0.2)


def sheet(name: str, facets: FacetSize) -> SheetMesh:
    """Mesh of one part, its load at node ``loaded[0]``."""
    if name == "flat":
        outline = 0.125 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

        def size(places: Array) -> Array:
            from_load = np.linalg.norm(places, axis=1)
            return np.minimum(facets.at_load + facets.growth_from_load * from_load, facets.flange)

        points, triangles, edge = mesh_in_plan(outline, np.zeros((1, 2)), size)
        return SheetMesh(np.column_stack([points, np.zeros(len(points))]), triangles, edge, np.array([0]))
    contours = cone(float(name.removeprefix("cone")))
    return mesh_of(formed_sheet(contours, CLAMP), contours[-1].contact[:1, :2], facets)


def own(mesh: SheetMesh) -> tuple[Array, float]:
    """(L,) mm, and CPU s."""
    started = time.process_time()
    model = ShellModel(mesh, sine_law_thickness(mesh, THICKNESS), YOUNG, POISSON, EdgeCondition())
    moved = follow_load(model, int(mesh.loaded[0]), np.array([0.0, 0.0, -1.0]), LOADS, model.factor())
    return -1e3 * moved[:, 2], time.process_time() - started


def calculix(mesh: SheetMesh, folder: Path) -> tuple[Array, float]:
    """(L,) mm, and wall s."""
    (folder / "sheet.inp").write_text(_input(mesh), encoding="ascii")
    started = time.perf_counter()
    subprocess.run(["ccx", "-i", "sheet"], cwd=folder, check=True, capture_output=True, timeout=1800)
    lines = (folder / "sheet.dat").read_text().splitlines()
    found = [-float(lines[k + 2].split()[3]) for k, line in enumerate(lines) if "displacements" in line]
    return np.array(found), time.perf_counter() - started


def _input(mesh: SheetMesh) -> str:
    """CalculiX input, mm and N."""
    pairs = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    sides, side, uses = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    count = len(mesh.points)
    points = 1e3 * np.vstack([mesh.points, mesh.points[sides].mean(axis=1)])
    elements = np.hstack([mesh.triangles, count + side.reshape(-1, 3)]) + 1
    thickness = np.round(1e3 * sine_law_thickness(mesh, THICKNESS), 3)
    held = {(int(number) // 6, int(number) % 6) for number in held_freedoms(mesh, EdgeCondition())}
    rim = set(mesh.edge.tolist())
    for middle, (a, b) in enumerate(sides[uses == 1]):
        if int(a) in rim and int(b) in rim:
            node = count + int(np.flatnonzero(uses == 1)[middle])
            held |= {(node, freedom) for freedom in (2, 3, 4)}
    text = ["*NODE,NSET=ALL", *(f"{k},{x:.9g},{y:.9g},{z:.9g}" for k, (x, y, z) in enumerate(points, start=1))]
    for number, value in enumerate(np.unique(thickness)):
        text.append(f"*ELEMENT,TYPE=S6,ELSET=T{number}")
        text += [f"{k + 1},{','.join(map(str, elements[k]))}" for k in np.flatnonzero(thickness == value)]
    text += ["*MATERIAL,NAME=SHEET", "*ELASTIC", f"{1e-6 * YOUNG},{POISSON}"]
    for number, value in enumerate(np.unique(thickness)):
        text += [f"*SHELL SECTION,ELSET=T{number},MATERIAL=SHEET", f"{value}"]
    text += ["*BOUNDARY", *(f"{node + 1},{freedom + 1},{freedom + 1}" for node, freedom in sorted(held))]
    load = int(mesh.loaded[0]) + 1
    text += ["*NSET,NSET=LOADED", str(load)]
    for force in LOADS:
        text += ["*STEP,NLGEOM,INC=200", "*STATIC", "1.,1.", "*CLOAD", f"{load},3,{-force}"]
        text += ["*NODE PRINT,NSET=LOADED,FREQUENCY=999", "U", "*END STEP"]
    return "\n".join(text) + "\n"


def main(names: Sequence[str]) -> int:
    """Table of every part; exit code 1 where the two are more than 0.1 mm apart."""
    if shutil.which("ccx") is None:
        print("ccx is not installed: apt install calculix-ccx", file=sys.stderr)
        return 2
    worst = 0.0
    print("part     corners        own 200 / 600 N [mm]   S6 200 / 600 N [mm]   own [s]   S6 [s]")
    for name in names:
        mesh, fine = sheet(name, FacetSize()), sheet(name, FINE)
        ours, own_time = own(mesh)
        with tempfile.TemporaryDirectory() as folder:
            theirs, their_time = calculix(fine, Path(folder))
        worst = max(worst, float(np.abs(ours - theirs)[list(SHOWN)].max()))
        nodes = f"{len(mesh.points):5} / {len(fine.points):5}"
        numbers = f"{ours[1]:8.3f} / {ours[3]:.3f}       {theirs[1]:8.3f} / {theirs[3]:.3f}"
        print(f"{name:8} {nodes}  {numbers}      {own_time:6.2f}   {their_time:6.1f}", flush=True)
    print(f"largest difference {worst:.3f} mm")
    return 0 if worst <= 0.1 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["flat", "cone45", "cone50"]))
