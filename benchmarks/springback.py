"""Springback methods side by side on the simulated machine: parts, methods and worlds in one table.

    ./isf python benchmarks/springback.py                    # small: mini_cone, worlds 0 and 1
    ./isf python benchmarks/springback.py --full             # every part, 20 off-nominal worlds (hours)
    ./isf python benchmarks/springback.py --jobs lu_cone --methods none fused --worlds 0 --json rows.json

World 0 is nominal, 1 to 20 are the standard ones (seed 0); in these sheet, machine and load cells are off by amounts
that the controllers do not know. Methods that look at the shape see a scan with noise, holes and registration after
every contour. Errors are vertical, in the clamp, formed minus target. A part that ends early keeps its row with its
code and counts in no median.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import statistics
import subprocess
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import isf_springback.estimators.elastic  # noqa: F401 - loaded before the processes start, so that all run the same code
from isf_analysis.measures.deviation import compare
from isf_cell import in_process
from isf_cell.commands.elastic_database import prepare_database
from isf_cell.commands.springback import edge_of
from isf_cell.commands.tryout import CONTROL_RATE
from isf_cell.options import RunOptions
from isf_cell.run.flat_push import push_flat_sheet
from isf_core.files.job import JobFile, load_job
from isf_planner import plan
from isf_springback.database.build import build_database
from isf_springback.database.database import cached_path, database_of

ROOT = Path(__file__).resolve().parents[1]
MODELS = ("none", "analytic", "elastic", "fused(analytic)", "fused(elastic)")
SHAPES = ("none", "mpc_vertical", "mpc_two_directional", "fused(analytic)")
PARTS: dict[str, Sequence[str]] = {
    "mini_cone": MODELS,
    "ren_cone": MODELS,
    "ren_pyramid": MODELS,
    "lu_cone": SHAPES,
    "lu_pyramid": SHAPES,
    "lu_asymmetric": SHAPES,
    "lu_tpif": ("none", "mpc_tpif"),
}
"""Methods that are compared on each part unless others are named."""
PUSHED = "+push"
"""End of a method: the edge of the clamp is calibrated before the part, by one push on the flat sheet."""
NO_FLOOR = "-floor"
"""End of a method: without the passes over the floor that the job asks for."""
REGIONS = ("wall_and_base", "wall", "base", "rim")
HEADER = (
    "| part | method | worlds | wall and base, max / mean | worst world | wall, max / mean | base, max / signed | "
    "rim, max / signed | within 0.3 mm |\n|---|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Case:
    """One run; ``method`` as in the table: fused with its model in brackets, and :data:`PUSHED`; ``sheet`` as of
    ``isf simulate``."""

    job: str
    method: str
    world: int
    sheet: str = "fast"


def job_of(case: Case) -> tuple[JobFile, str]:
    """The job of a case, with scans where its method looks at the shape, and the name of the method."""
    job_file = load_job(ROOT / "examples" / "jobs" / f"{case.job}.yaml")
    if case.method.endswith(NO_FLOOR):
        path = job_file.job.path.model_copy(update={"floor_step": "none"})
        job_file.job = job_file.job.model_copy(update={"path": path})
    name, _, model = case.method.removesuffix(PUSHED).removesuffix(NO_FLOOR).rstrip(")").partition("(")
    looks = name == "fused" or name.startswith("mpc")
    change: dict[str, Any] = {"method": name, "scan_every": 1 if looks else 0, "scan_sensor": True}
    if model:
        change["fused"] = job_file.job.springback.fused.model_copy(update={"model": model})
    if case.method.endswith(PUSHED):
        edge = edge_of(job_file, push_flat_sheet(job_file, case.world)).edge
        found = {"edge_slope": edge.slope, "edge_stiffness": None if edge.immovable else edge.in_plane}
        change["elastic"] = job_file.job.springback.elastic.model_copy(update=found)
    springback = job_file.job.springback.model_copy(update=change)
    job_file.job = job_file.job.model_copy(update={"springback": springback})
    if case.sheet != "fast":
        control = job_file.job.control.model_copy(update={"rate": CONTROL_RATE})
        job_file.job = job_file.job.model_copy(update={"control": control})
    return job_file, name


def with_database(job_file: JobFile) -> None:
    """Compute the database of a job in this process, silently, unless the cache holds it: runs stand side by side."""
    if database_of(job_file) is None:
        build_database(plan(job_file).contours, job_file, workers=0).save(cached_path(job_file))


def prepare(job: str) -> None:
    """Compute the database of the elastic model unless the cache holds it."""
    prepare_database(load_job(ROOT / "examples" / "jobs" / f"{job}.yaml"), "elastic", print)


def run(case: Case) -> dict[str, Any]:
    """Numbers of one run, mm."""
    job_file, name = job_of(case)
    if case.method.endswith(PUSHED):
        with_database(job_file)
    record = in_process.form(job_file, RunOptions(correction=name, variant=case.world, seed=0, sheet=case.sheet))
    row: dict[str, Any] = {**vars(case), "contours": len(record.results), "code": int(record.results[-1].code)}
    if record.scan is None or record.target is None:
        return row
    deviation = compare(record.scan, record.target)
    regions = deviation.regions
    row["within"] = 100.0 * (deviation.within(0.3e-3) or 0.0)
    for region in REGIONS:
        errors = regions[region]
        if errors is not None:
            row[region] = {
                "max": 1e3 * errors.max_abs,
                "mean": 1e3 * errors.mean_abs,
                "signed": 1e3 * errors.mean,
            }
    return row


def line(job: str, method: str, rows: Sequence[dict[str, Any]]) -> str:
    """One line of the table: medians over the worlds, and the worst world of wall and base."""
    whole = [row for row in rows if row["code"] == 0 and "wall_and_base" in row]
    ended = [f"world {row['world']} ended at contour {row['contours']}, {row['code']}" for row in rows if row["code"]]
    worlds = ", ".join([f"{len(whole)}", *ended])
    if not whole:
        return f"| {job} | {method} | {worlds} | - | - | - | - | - | - |"

    def median(region: str, kind: str) -> str:
        return f"{statistics.median(row[region][kind] for row in whole):.2f}"

    worst = " / ".join(f"{max(row['wall_and_base'][kind] for row in whole):.2f}" for kind in ("max", "mean"))
    cells = [
        f"{median('wall_and_base', 'max')} / {median('wall_and_base', 'mean')}",
        worst,
        f"{median('wall', 'max')} / {median('wall', 'mean')}",
        f"{median('base', 'max')} / {median('base', 'signed')}",
        f"{median('rim', 'max')} / {median('rim', 'signed')}",
        f"{statistics.median(row['within'] for row in whole):.0f} %",
    ]
    return f"| {job} | {method} | {worlds} | " + " | ".join(cells) + " |"


def plant_commit() -> str:
    """Short id of the last commit of the simulated machine, with a mark when its files have been changed since."""
    package = "ros_ws/src/isf_sim"
    found = subprocess.run(
        ["git", "log", "-1", "--format=%h", "--", package], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()
    changed = subprocess.run(
        ["git", "status", "--porcelain", "--", package], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()
    return (found or "unknown") + (" with changes" if changed else "")


def main() -> None:
    """Run all cases on all cores and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="all parts, worlds 0 to 20")
    parser.add_argument("--jobs", nargs="+", choices=sorted(PARTS))
    parser.add_argument("--methods", nargs="+", help="for example: none analytic 'fused(elastic)'")
    parser.add_argument("--worlds", nargs="+", type=int)
    parser.add_argument("--processes", type=int)
    parser.add_argument("--json", type=Path, help="file that receives every run, written as they come")
    arguments = parser.parse_args()
    jobs = arguments.jobs or (list(PARTS) if arguments.full else ["mini_cone"])
    worlds = arguments.worlds or (list(range(21)) if arguments.full else [0, 1])
    cases = [Case(job, method, world) for job in jobs for world in worlds for method in arguments.methods or PARTS[job]]
    print(f"plant of commit {plant_commit()}; medians over the worlds; mm\n")
    for job in jobs:
        if any("elastic" in case.method for case in cases if case.job == job):
            prepare(job)
    found: dict[Case, dict[str, Any]] = {}
    with ProcessPoolExecutor(arguments.processes, mp_context=multiprocessing.get_context("fork")) as pool:
        waiting = {pool.submit(run, case): case for case in cases}
        for done in as_completed(waiting):
            found[waiting[done]] = done.result()
            if arguments.json:
                arguments.json.write_text(json.dumps(list(found.values())) + "\n", encoding="utf-8")
    print(HEADER)
    for job in jobs:
        for method in arguments.methods or PARTS[job]:
            print(line(job, method, [found[Case(job, method, world)] for world in worlds]))


if __name__ == "__main__":
    main()
