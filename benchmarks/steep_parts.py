"""Features, morphed shapes and sequenced partial paths of a part of 200,000 facets: processor time, memory, a picture.

usage: ./isf python benchmarks/steep_parts.py [--facets N] [--picture FILE]
       ./isf python benchmarks/steep_parts.py --formed "one pass=RUN" "morphed=RUN" --picture FILE   (their sections)
The part is the pyramid of examples/jobs/behera_80_25.yaml with its facets divided. Times are of one core; run it with
OMP_NUM_THREADS=1 where numpy's libraries use more.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh
from isf_analysis.bag.bag_reader import read_bag
from isf_core.files.job import JobFile, load_job
from isf_planner import plan
from isf_planner.features.segmentation import find_features
from isf_planner.forming.stages import Preforms, preforms
from isf_planner.part import mesh_checks
from isf_planner.part.meshes import Mesh, load_mesh

JOB = Path(__file__).resolve().parents[1] / "examples" / "jobs" / "behera_80_25.yaml"


def divided(mesh: Mesh, facets: int) -> Mesh:
    """The mesh with its longest edges halved until it has at least so many facets."""
    edge = 8e-3
    while True:
        vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, edge, max_iter=30)
        if len(faces) >= facets:
            fine = trimesh.Trimesh(vertices, faces)
            return Mesh(np.array(fine.vertices), np.array(fine.faces))
        edge *= 0.9


def draw(made: Preforms, path: Path) -> None:
    """Section through the middle of every stage."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    for number, stage in enumerate(made.stages, start=1):
        heights = stage.heights
        name = "part" if number == len(made.stages) else f"shape {number}"
        label = f"{name}: {stage.depth * 1e3:.0f} mm, {np.degrees(stage.wall_angle):.0f} deg"
        axes.plot(heights.x * 1e3, heights.z[len(heights.y) // 2] * 1e3, label=label)
    axes.set(aspect="equal", xlabel="x in mm", ylabel="z in mm")
    axes.legend(frameon=False, fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=110)


def draw_formed(runs: list[str], path: Path) -> None:
    """Section along x through parts that were formed, ``runs`` as LABEL=RUN, and their target."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    axes = figure.add_subplot()
    for number, run in enumerate(runs):
        label, _, where = run.partition("=")
        record = read_bag(Path(where))
        if record.scan is None or record.target is None:
            raise SystemExit(f"{where}: no scan or no target in it")
        x = np.arange(record.target.x[0], record.target.x[-1], 0.25e-3)
        line = np.column_stack([x, 0.0 * x])
        if number == 0:
            axes.plot(x * 1e3, record.target.at(line) * 1e3, "k--", label="part", linewidth=1.2)
        axes.plot(x * 1e3, record.scan.at(line) * 1e3, label=label)
    axes.set(aspect="equal", xlabel="x in mm", ylabel="z in mm")
    axes.legend(frameon=False, fontsize=9, loc="lower left")
    figure.savefig(path, dpi=110)


def sequenced(part: Mesh) -> float:
    """s of processor time to plan ``part``, reading included, with four shapes and a path for every feature."""
    text = JOB.read_text().replace("shapes: 3", "shapes: 4").replace("path:\n", "path:\n  partial_paths: true\n")
    with TemporaryDirectory() as name:
        folder = Path(name)
        trimesh.Trimesh(part.vertices * 1e3, part.faces, process=False).export(folder / "part.stl")
        started = time.process_time()
        plan(JobFile(text.replace("../parts/behera_80_25.stl", "part.stl"), folder))
        return time.process_time() - started


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--facets", type=int, default=200_000)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--formed", nargs="+", metavar="LABEL=RUN", help="draw these, measure nothing")
    given = parser.parse_args()
    if given.formed:
        draw_formed(given.formed, given.picture or parser.error("--formed needs --picture"))
        return
    job_file = load_job(JOB)
    loaded = load_mesh(job_file.mesh, job_file.job.part.unit)
    part = divided(mesh_checks.check_and_place(loaded, (0.182, 0.182), 5e-3).mesh, given.facets)
    radius = job_file.job.tool_1.ball_radius
    started = time.process_time()
    found = find_features(part, radius)
    features = time.process_time() - started
    started = time.process_time()
    made = preforms(part, [1], job_file, lambda phase, share: None)
    shapes = time.process_time() - started
    plan_seconds = sequenced(part)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"{len(part.faces)} facets; processor time {features:.1f} s for features, {shapes:.1f} s for shapes")
    print(f"whole plan, four shapes and the part with sequenced partial paths: {plan_seconds:.1f} s")
    print(f"largest memory {memory:.0f} MB; {found.counts()}")
    if given.picture:
        draw(made, given.picture)


if __name__ == "__main__":
    main()
