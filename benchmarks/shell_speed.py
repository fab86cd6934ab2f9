"""Speed of the elastic shell: 60 control points of the rounded pyramid with six loads each, meshes included.

    ./isf python benchmarks/shell_speed.py [--processes 2]

Twenty depths with three points each. CPU of one process, least of some runs; with ``--processes`` the same tasks in
that many, started and warm: wall time, and the CPU of the busiest, which is the wall time on cores of their own.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from isf_core.files.job import load_job
from isf_planner import plan
from isf_springback.database.build import control_loops_of, database_tasks
from isf_springback.database.elastic_samples import DepthTask, solve_depth
from isf_springback.shell.warm_up import warm_up
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
DEPTHS, POINTS = 20, 3


def tasks_of(job: str = "ren_pyramid") -> list[DepthTask]:
    """Tasks of twenty depths, three points each, evenly chosen among the computed control points."""
    job_file = load_job(ROOT / "examples" / "jobs" / f"{job}.yaml")
    contours = plan(job_file).contours
    tasks = [
        task for task in database_tasks(contours, control_loops_of(contours, job_file), job_file) if len(task.points)
    ]
    index = [contour.index for contour in contours]
    chosen = [tasks[k] for k in np.linspace(0, len(tasks) - 1, DEPTHS).round().astype(int)]
    return [replace(task, points=_three(task, contours[index.index(task.index)].contact[:, :2])) for task in chosen]


def _three(task: DepthTask, loop: NDArray[np.float64]) -> NDArray[np.float64]:
    """Three points: those of the task, else more of its loop at an eighth of its length."""
    points = list(task.points[:POINTS])
    for k in range(POINTS - len(points)):
        points.append(loop[(k + 1) * len(loop) // 16])
    return np.array(points)


def main() -> None:
    """Print CPU and wall times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=0)
    parser.add_argument("--repeat", type=int, default=2)
    options = parser.parse_args()
    warm_up()
    tasks = tasks_of()
    points = sum(len(task.points) for task in tasks)
    times: list[float] = []
    for _ in range(options.repeat):
        times.append(sum(_timed(task)[1] for task in tasks))
    print(f"{points} points, {len(tasks[0].loads)} loads, {len(tasks)} meshes: {min(times):.2f} s CPU in one process")
    if options.processes:
        context = multiprocessing.get_context("fork")
        with ProcessPoolExecutor(options.processes, mp_context=context) as pool:
            list(pool.map(time.sleep, [0.0] * options.processes))
            started = time.perf_counter()
            used: dict[int, float] = {}
            for process, seconds in pool.map(_timed, tasks[::-1]):
                used[process] = used.get(process, 0.0) + seconds
            wall = time.perf_counter() - started
            print(f"{options.processes} processes: {wall:.2f} s wall, CPU of the busiest {max(used.values()):.2f} s")


def _timed(task: DepthTask) -> tuple[int, float]:
    """Number of the process, and its CPU time, s, for one task."""
    used = time.process_time()
    solve_depth(task)
    return os.getpid(), time.process_time() - used


if __name__ == "__main__":
    main()
