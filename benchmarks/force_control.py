"""How well the contact force is held: set-points, parts and worlds, on the simulated machine in this process.

    ./isf python benchmarks/force_control.py                        # mini_cone and ren_pyramid, nominal world
    ./isf python benchmarks/force_control.py --full                 # all set-points, 20 off-nominal worlds (hours)
    ./isf python benchmarks/force_control.py --set loop_gain=40     # with other values of ControlConfig

One row per run. Every engaged tick counts (mode CONTROL, corners and the first contours included), and the error is
measured force less set-point, unfiltered.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import ContourResult
from isf_core.job import JobFile, load_job
from isf_force_ctrl import ControlConfig, ForceController
from isf_planner import plan
from isf_sim.machine import SimulatedMachine
from isf_springback.method import apply, make_method

ROOT = Path(__file__).resolve().parents[1]
HEADER = (
    "| job | N | world | within 10 N [%] | RMS [N] | 99.9 % below [N] | largest [N] | contact [%] | back-offs | "
    "forming [s] | worst contours (within 10 N [%]) |\n|---|---|---|---|---|---|---|---|---|---|---|"
)
SET_POINTS = (100.0, 120.0, 180.0, 200.0, 300.0)


@dataclass(frozen=True)
class Case:
    """One run; ``changes`` replace fields of ControlConfig."""

    job: str
    force: float
    world: int
    correction: str
    changes: tuple[tuple[str, float], ...]
    contours: int | None = None


def results(case: Case) -> Iterator[ContourResult]:
    """Results of the contours of one part."""
    job_file: JobFile = load_job(ROOT / "examples" / "jobs" / f"{case.job}.yaml")
    part = plan(job_file)
    machine = SimulatedMachine(job_file, world=case.world)
    machine.tare()
    method = make_method(case.correction, job_file)
    config = ControlConfig.from_job(job_file, support_force=case.force)
    controller = ForceController(replace(config, **dict(case.changes)))
    sample = machine.sample()
    controller.arm(part.plan_id, 0, len(part.contours), sample.tip_1.tolist(), sample.tip_2.tolist())
    for nominal in part.contours[: case.contours]:
        corrected = apply(nominal, method.correct(nominal))
        controller.start(corrected)
        while controller.busy:
            targets = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            sample = machine.tick(targets.tip_1, targets.tip_2)
        result = controller.take_result()
        assert result is not None
        method.learn(corrected, result)
        yield result
        if not result.completed:
            return


def measure(case: Case) -> dict[str, Any]:
    """Numbers of one run."""
    errors, contact, worst, backoffs = [], [], [], 0
    code, time = 0, 0.0
    for result in results(case):
        code = code or result.code
        backoffs += result.backoffs
        time += result.end - result.start
        engaged = result.tick_engaged
        if not len(result.tick_set_point) or not engaged.any():
            continue
        error = (result.tick_normal_force - result.tick_set_point)[engaged]
        errors.append(error)
        contact.append(result.tick_normal_force[engaged] > 5.0)
        worst.append((100.0 * float(np.mean(np.abs(error) <= 10.0)), result.index))
    error = np.abs(np.concatenate(errors))
    return {
        "within": 100.0 * float(np.mean(error <= 10.0)),
        "rms": float(np.sqrt(np.mean(error**2))),
        "p999": float(np.percentile(error, 99.9)),
        "most": float(error.max()),
        "contact": 100.0 * float(np.concatenate(contact).mean()),
        "backoffs": backoffs,
        "worst": sorted(worst)[:4],
        "code": code,
        "time": time,
    }


def row(case: Case, data: dict[str, Any]) -> str:
    """One line of the table."""
    worst = ", ".join(f"{index}: {share:.1f}" for share, index in data["worst"])
    failed = f" (ended with {data['code']})" if data["code"] else ""
    return (
        f"| {case.job}{failed} | {case.force:.0f} | {case.world} | {data['within']:.2f} | {data['rms']:.2f} | "
        f"{data['p999']:.1f} | {data['most']:.1f} | {data['contact']:.2f} | {data['backoffs']} | {data['time']:.0f} | "
        f"{worst} |"
    )


def main() -> None:
    """Run all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="all set-points, worlds 0 to 20")
    parser.add_argument("--jobs", nargs="+", default=("mini_cone", "ren_pyramid"))
    parser.add_argument("--forces", nargs="+", type=float, default=(120.0,))
    parser.add_argument("--worlds", nargs="+", type=int, default=(0,))
    parser.add_argument("--correction", default="analytic")
    parser.add_argument("--contours", type=int, help="only so many contours of each part")
    parser.add_argument("--set", nargs="*", default=(), metavar="FIELD=VALUE", help="fields of ControlConfig")
    parser.add_argument("--processes", type=int, default=1)
    arguments = parser.parse_args()
    changes = tuple((name, float(value)) for name, _, value in (item.partition("=") for item in arguments.set))
    forces = SET_POINTS if arguments.full else arguments.forces
    worlds = tuple(range(21)) if arguments.full else arguments.worlds
    cases = [
        Case(job, force, world, arguments.correction, changes, arguments.contours)
        for job in arguments.jobs
        for force in forces
        for world in worlds
    ]
    print(HEADER, flush=True)
    with ProcessPoolExecutor(arguments.processes) as pool:
        for case, data in zip(cases, pool.map(measure, cases), strict=True):
            print(row(case, data), flush=True)


if __name__ == "__main__":
    main()
