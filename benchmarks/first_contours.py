"""First contour corrected by the predicted force or not at all, method by method: the table of
docs/methods/springback.md.

    ./isf python benchmarks/first_contours.py [--jobs ren_cone ren_pyramid] [--world 0]

"No rise by the plan" takes the planner's forces out of every contour but the first, so that the forecast knows
measured ones alone. Errors are vertical, in the clamp, wall and base, largest / mean, mm. Nominal plant unless another
world is named; methods and scans as in benchmarks/springback.py. Some ten minutes on one core.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from isf_analysis.measures.deviation import compare
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_core.files.job import JobFile
from isf_planner import Plan, plan
from springback import Case, job_of, prepare

JOBS = ("ren_cone", "ren_pyramid")
NO_RISE = ", no rise by the plan"
"""End of a row's method; see the module text."""

METHODS = (f"elastic{NO_RISE}", "elastic", "analytic", "fused(elastic)")
CHOICES = ("zero", "predicted")


def main() -> None:
    """Form and print, row by row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", nargs="+", default=JOBS)
    parser.add_argument("--methods", nargs="+", default=METHODS)
    parser.add_argument("--world", type=int, default=0)
    arguments = parser.parse_args()
    print("| part | method | first contour zero | predicted |\n|---|---|---|---|")
    for job in arguments.jobs:
        if any("elastic" in method for method in arguments.methods):
            prepare(job)
        for method in arguments.methods:
            cells = [run(Case(job, method.removesuffix(NO_RISE), arguments.world), method, how) for how in CHOICES]
            print(f"| {job} | {method} | {' | '.join(cells)} |", flush=True)


def run(case: Case, method: str, first_contour: str) -> str:
    """Largest / mean error in mm of one run, or how it ended early."""
    job_file, name = job_of(case)
    springback = job_file.job.springback.model_copy(update={"first_contour": first_contour, "lift_every": 0})
    job_file.job = job_file.job.model_copy(update={"springback": springback})
    options = RunOptions(correction=name, variant=case.world, seed=0)
    record = in_process.form(job_file, options, part_plan=plan_for(job_file, method))
    last = record.results[-1]
    if not last.completed:
        return f"ended at contour {len(record.results)}, {last.code}"
    assert record.scan is not None  # the simulated machine always gives one
    assert record.target is not None
    errors = compare(record.scan, record.target).regions["wall_and_base"]
    assert errors is not None
    return f"{1e3 * errors.max_abs:.2f} / {1e3 * errors.mean_abs:.2f}"


def plan_for(job_file: JobFile, method: str) -> Plan:
    """The plan of a job, without the planner's forces where the method's row says so."""
    made = plan(job_file)
    if not method.endswith(NO_RISE):
        return made
    first, *others = made.contours
    return replace(made, contours=(first, *(replace(c, predicted_force=np.empty(0)) for c in others)))


if __name__ == "__main__":
    main()
