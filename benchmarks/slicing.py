"""How long slicing and planning take, and how they grow with the mesh.

    ./isf python benchmarks/slicing.py

1. 49 level sections of a closed body of 10k, 100k and 1M facets: ours, trimesh's ``section_multiplane`` and the
   slicing step of PrusaSlicer and CuraEngine, from facets to closed polygons, one after the other on the same mesh.
   Processor time (user and system, of all threads), best of several runs: other work on the computer disturbs it far
   less than the time on the wall. Of the two programs it is read from the kernel when their log tells that the step
   begins and ends. A fitted exponent tells the growth in facets and in levels.
2. The whole plan of a part of 1M facets with more than 100 contours (contacts, normals, tips of two tools, checks), in
   a process of its own: processor time and peak memory; then a change of tool on the finished plan.

A program that is missing is skipped with a line. CuraEngine needs the definitions of printers of the package ``cura``,
which need not be installed: ``apt-get download cura && dpkg -x cura_*.deb FOLDER``, then
``CURA_DEFINITIONS=FOLDER/usr/share/cura/resources``.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_planner import plan, replan
from isf_planner.checks.mesh_slicing import slice_mesh
from isf_planner.part.meshes import Mesh
from numpy.typing import NDArray

FACETS = (10_000, 100_000, 1_000_000)
LEVELS = 49

LONGEST = 400
"""s, after which a slicer is given up."""

JOB = """
name: benchmark
part: {{mesh: part.stl, unit: mm}}
process: DSIF
rig: ren2018
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{radius: {radius} mm}}
tool_2: {{radius: 5 mm}}
wall_angle_limit: 85 deg
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
"""


def pocket(facets: int, side: float, depth: float) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """An oval pocket with an island, mm: vertices, facets and the vertices along the rim."""
    n = round(np.sqrt(facets / 2)) + 1
    x = np.linspace(-side / 2, side / 2, n)
    gx, gy = np.meshgrid(x, x)
    r = np.hypot(gx, gy * 1.1) / (0.45 * side)
    z = -depth * (0.5 + 0.5 * np.cos(np.pi * np.clip((r - 0.3) / 0.7, 0, 1))) + 0.08 * depth * np.exp(
        -((r / 0.12) ** 2)
    )
    node = np.arange(n * n).reshape(n, n)
    a, b, c, d = (node[i : n - 1 + i, j : n - 1 + j].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    rim = np.concatenate([node[0, :-1], node[:-1, -1], node[-1, :0:-1], node[:0:-1, 0]])
    z[np.abs(z) < 1e-4] = 0.0
    return np.column_stack([gx.ravel(), gy.ravel(), z.ravel()]), faces, rim


def body(facets: int) -> trimesh.Trimesh:
    """The pocket in a closed block of 120 x 120 x 25 mm, on z = 0."""
    top, faces, rim = pocket(facets, 120.0, 20.0)
    top = top + [0.0, 0.0, 25.0]
    m, first = len(rim), len(top)
    k = np.arange(m)
    after = (k + 1) % m
    walls = [np.column_stack([rim, first + k, first + after]), np.column_stack([rim, first + after, rim[after]])]
    floor = np.column_stack([first + after, first + k, np.full(m, first + m)])
    vertices = np.vstack([top, top[rim] * [1, 1, 0], [[0.0, 0.0, 0.0]]])
    return trimesh.Trimesh(vertices, np.vstack([faces, *walls, floor]), process=False)


def best_of(work: Callable[[], object], repeats: int) -> float:
    """Least processor time, s."""
    times = []
    for _ in range(repeats):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return min(times)


def step_time(command: list[str], begins: str, ends: str, environment: dict[str, str]) -> float | None:
    """s of processor time between two lines of a program's log; None when they do not come."""
    running = subprocess.Popen(
        ["timeout", str(LONGEST), *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env={**os.environ, **environment},
    )
    assert running.stdout is not None
    started = found = None
    for line in running.stdout:
        if started is None and begins in line:
            started = used(running.pid)
        elif started is not None and found is None and ends in line:
            found = used(running.pid) - started
    running.wait()
    return found


def used(pid: int) -> float:
    """s, processor time of all threads of the child of ``timeout`` so far, as the scheduler counts it."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    tasks = Path(f"/proc/{children[0]}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) * 1e-9


def prusa(path: Path, folder: Path) -> float | None:
    """s, PrusaSlicer from facets to polygons; None when it is not installed."""
    program = shutil.which("prusa-slicer")
    if program is None:
        return None
    options = "--layer-height 0.5 --first-layer-height 0.5 --nozzle-diameter 1 --perimeters 1 --fill-density 0"
    options += " --skirts 0 --top-solid-layers 0 --bottom-solid-layers 0 --loglevel 5"
    command = [program, "--slice", *options.split(), "-o", str(folder / "out.gcode"), str(path)]
    return step_time(command, "slice_mesh to polygons", "removing top empty layers", {})


def cura(path: Path, folder: Path) -> float | None:
    """s, CuraEngine from facets to polygons; None when it or its definitions are not there."""
    program, resources = (
        shutil.which("CuraEngine"),
        Path(os.environ.get("CURA_DEFINITIONS", "/usr/share/cura/resources")),
    )
    printer = resources / "definitions" / "fdmprinter.def.json"
    if program is None or not printer.exists():
        return None
    options = "layer_height=0.5 layer_height_0=0.5 machine_width=300 machine_depth=300 machine_height=100"
    options += " machine_center_is_zero=true adhesion_type=none wall_line_count=1 top_layers=0 bottom_layers=0"
    options += " infill_sparse_density=0 infill_line_distance=0"
    settings = [word for option in options.split() for word in ("-s", option)]
    command = [program, "slice", "-v", "-p", "-m1", "-j", str(printer), *settings, "-e0", "-l", str(path)]
    search = {"CURA_ENGINE_SEARCH_PATH": f"{resources / 'definitions'}:{resources / 'extruders'}"}
    return step_time([*command, "-o", str(folder / "out.gcode")], "Starting slice...", "slice make polygons", search)


PROGRAMS = {"PrusaSlicer": prusa, "CuraEngine": cura}


def exponent(sizes: Array, times: Array) -> float:
    """Slope of log time over log size."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def sections(folder: Path) -> None:
    """Table 1."""
    levels = 0.25 + 0.5 * np.arange(LEVELS)
    rows = []
    for facets in FACETS:
        solid = body(facets)
        path = folder / f"body_{facets}.stl"
        solid.export(path)
        mesh = Mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
        slice_mesh(mesh, levels)
        ours = best_of(lambda mesh=mesh: slice_mesh(mesh, levels), 7)
        theirs = best_of(lambda solid=solid: solid.section_multiplane([0, 0, 0], [0, 0, 1], levels), 2)
        others = {name: [program(path, folder) for _ in range(3)] for name, program in PROGRAMS.items()}
        best = [min((value for value in times if value is not None), default=np.nan) for times in others.values()]
        rows.append((len(mesh.faces), ours, theirs, *best))
        print(
            f"{len(mesh.faces):>8} facets: ours {ours * 1e3:.2f} ms"
            + "".join(
                f", {name} {value * 1e3:.0f} ms ({value / ours:.1f} x)" if np.isfinite(value) else f", {name} skipped"
                for name, value in zip(("trimesh", *PROGRAMS), rows[-1][2:], strict=True)
            ),
            flush=True,
        )
    table = np.array(rows)
    for column, name in enumerate(("ours", "trimesh", *PROGRAMS), 1):
        if np.isfinite(table[:, column]).all():
            print(f"growth in facets, {name}: time ~ facets^{exponent(table[:, 0], table[:, column]):.2f}")
    counts = np.array([12, 49, 196, 784])
    times = [best_of(lambda n=n: slice_mesh(mesh, np.linspace(0.3, 24.7, n)), 5) for n in counts]
    print(
        "growth in levels at 1M facets, ours: "
        + ", ".join(f"{n}: {value * 1e3:.0f} ms" for n, value in zip(counts, times, strict=True))
        + f"; time ~ levels^{exponent(counts, np.array(times)):.2f}"
    )


def whole_plan(folder: Path) -> None:
    """Table 2, in this process: nothing else was done in it."""
    vertices, faces, _ = pocket(1_000_000, 220.0, 50.0)
    trimesh.Trimesh(vertices, faces, process=False).export(folder / "part.stl")
    job_file = JobFile(JOB.format(radius=5), folder)
    small, few, _ = pocket(2_000, 60.0, 4.0)
    (folder / "small").mkdir()
    trimesh.Trimesh(small, few, process=False).export(folder / "small" / "part.stl")
    plan(JobFile(JOB.format(radius=5), folder / "small"))  # loads the compiled kernels
    del vertices, faces
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    times = []
    for _ in range(3):
        wall, started = time.perf_counter(), time.process_time()
        made = plan(job_file)
        times.append((time.process_time() - started, time.perf_counter() - wall))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    points = sum(len(contour) for contour in made.contours)
    print(
        f"whole plan, 1M facets: {len(made.contours)} contours, {points} points, {min(times)[0]:.2f} s processor time "
        f"({min(wall for _, wall in times):.2f} s), peak {peak:.0f} MB (before, making the part: {before:.0f} MB)"
    )
    kept = best_of(lambda: replan(made, JobFile(JOB.format(radius=4.5), folder)), 3)
    print(f"the same with another forming tool (replan): {kept * 1e3:.0f} ms")


def main() -> None:
    """Both tables; the second in a process of its own, so that its memory is its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "--plan" in sys.argv:
            whole_plan(folder)
            return
        os.sched_setaffinity(0, {0})
        sections(folder)
        subprocess.run([sys.executable, __file__, "--plan"], check=True)


if __name__ == "__main__":
    main()
