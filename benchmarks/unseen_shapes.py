"""Shapes that no constant was chosen by, formed as the page "First own part" writes a job: one tool, defaults.

An L, a star, two pockets of different depth, a ridge that flattens towards its crown, a cone whose sides differ, and
the first feature of a free form, from the part library; AA5754-O of 1 mm on the rig ren2018. Each is formed over the
backing plate that its plan advises. ``isf campaign`` forms what is missing of the folder and writes its table and page.

    ./isf python benchmarks/unseen_shapes.py                                # every method, nominal
    ./isf python benchmarks/unseen_shapes.py --methods elastic --variants 101-105 --jobs 2

elastic is what the job does by itself, walls the same without passes over the floor, fused scans after every contour. A
part on shell_coarse takes 2 to 7 minutes of one core. In the rows: wall and base, largest / mean; signed means of base
and rim; of several variants the median, and the worst behind it.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yaml
from isf_core.files.job import JobFile
from isf_planner import plan
from isf_planner.checks.backing_plate import nearer_plate, plate_file
from isf_planner.part.meshes import Mesh
from isf_planner.part_library import catalogue
from isf_planner.part_library.part import Part
from isf_planner.part_library.part_mesh import part_mesh

ROOT = Path(__file__).resolve().parents[1]


def first_of_free_form() -> Part:
    """The free form without the feature that a second tool forms from below."""
    part = catalogue.free_form()
    return replace(part, features=part.features[:1])


SHAPES: dict[str, Callable[[], Part]] = {
    "l_shape": catalogue.l_shape,
    "star": catalogue.star,
    "two_pockets": catalogue.two_pockets,
    "airfoil_ridge": catalogue.airfoil_ridge,
    "asymmetric_cone": catalogue.asymmetric_cone,
    "free_form": first_of_free_form,
}

METHODS: dict[str, Any] = {
    "none": "none",
    "elastic": "elastic",
    "walls": {"name": "elastic, walls alone", "change": {"path": {"floor_step": "none"}}},
    "fused": {"name": "fused", "change": {"springback": {"method": "auto", "scan_every": 1}}},
}

JOB = """\
name: {name}
part: {{mesh: {name}.stl, unit: mm}}
process: SPIF
rig: ren2018
{plate}sheet: {{material: AA5754-O, thickness: 1.0 mm}}
tool_1: {{radius: 5 mm}}
path: {{incremental_depth: {step} mm, feed: 30 mm/s}}
control: {{rate: 100 Hz}}
"""


def write_job(folder: Path, name: str, step: float) -> Path:
    """Mesh and job of the shape ``name`` over the plate that its plan advises; steps of ``step`` mm."""
    mesh = part_mesh(SHAPES[name]())
    trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(folder / f"{name}.stl")
    free = JobFile(JOB.format(name=name, plate="", step=step), folder, name)
    planned = plan(free)
    plate = nearer_plate(planned.contours, Mesh(*planned.mesh), free.job, free.rig)
    assert plate is not None, f"{name}: no plate is advised"
    (folder / f"{name}_plate.yaml").write_text(plate_file(plate, name), encoding="utf-8")
    path = folder / f"{name}.yaml"
    path.write_text(JOB.format(name=name, plate=f"backing_plate: {name}_plate.yaml\n", step=step), encoding="utf-8")
    return path


def show(path: Path) -> None:
    """Print the rows of the table ``path``."""
    rows: dict[tuple[str, str], list[dict[str, str]]] = {}
    with path.open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            rows.setdefault((row["job"], row["method"]), []).append(row)
    print("| shape | method | variants | wall and base [mm] | worst | base | rim |\n|---|---|---|---|---|---|---|")
    for (job, method), found in rows.items():
        whole = [row for row in found if row["code"] == "0"]
        columns = ("max_mm", "mean_mm", "base_signed_mm", "rim_signed_mm")
        values = np.array([[float(row[name]) for name in columns] for row in whole]).reshape(-1, len(columns))
        if not len(values):
            print(f"| {job} | {method} | 0 of {len(found)} | {found[0]['message'][:60]} | | | |")
            continue
        largest, mean, base, rim = np.median(values, axis=0)
        worst = f"{values[:, 0].max():.2f} / {values[:, 1].max():.2f}" if len(values) > 1 else "-"
        of = f"{len(values)} of {len(found)}"
        print(f"| {job} | {method} | {of} | {largest:.2f} / {mean:.2f} | {worst} | {base:+.2f} | {rim:+.2f} |")


def main() -> int:
    """Write the campaign and form what is missing of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", nargs="+", choices=SHAPES, default=list(SHAPES))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--variants", nargs="+", default=["0"], help="numbers and ranges")
    parser.add_argument("--sheet", default="shell_coarse", help="simulated sheet")
    parser.add_argument("--step", type=float, default=0.5, help="mm, depth of a contour below the one before")
    parser.add_argument("--jobs", type=int, default=1, help="parts at a time")
    parser.add_argument("--output", type=Path, default=Path("runs") / "unseen_shapes")
    given = parser.parse_args()
    jobs = given.output / "jobs"
    jobs.mkdir(parents=True, exist_ok=True)
    campaign = {
        "name": "unseen_shapes",
        "jobs": [write_job(jobs, name, given.step).name for name in given.shapes],
        "methods": [METHODS[name] for name in given.methods],
        "variants": given.variants,
        "sheets": [given.sheet],
    }
    (jobs / "campaign.yaml").write_text(yaml.safe_dump(campaign, sort_keys=False), encoding="utf-8")
    command = [str(ROOT / "isf"), "campaign", str(jobs / "campaign.yaml"), "--jobs", str(given.jobs)]
    parts = given.output / "parts"
    code = subprocess.run([*command, "--output", str(parts)], check=False).returncode
    if (parts / "campaign.csv").exists():
        show(parts / "campaign.csv")
    return code


if __name__ == "__main__":
    sys.exit(main())
