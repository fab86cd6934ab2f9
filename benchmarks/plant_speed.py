"""How fast the sheet of the simulated machine is: points per second, share of the coarse solutions, control ticks.

    ./isf python benchmarks/plant_speed.py [--step MM] [--repeat N] [--ticks N] [--fifo PRIORITY]

Forms the cone of Ren 2018 (opening radius 36 mm, 50 deg, 21 mm deep) point by point in 0.5 mm spacing: CPU time of this
process (smallest of the repeats), at half and at full depth, and the exponent of the time over the points. Then a loop
through the whole machine at 500 Hz, 30 mm/s: wall time of the ticks in lockstep (a solution is computed in the tick
that begins it) and in real time (in a thread; a tick every 2 ms), with the interpreter as it is and as the node sets it
(threads give way soon, nothing old for the collector); *work* are the ticks that begin or take over a solution or move
the base. Wall times count on a quiet computer only; on a busy one ``--fifo`` keeps other processes off the core, but
not off its caches.
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from isf_core.files.job import JobFile
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.types import Array
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.real_time import PeriodicThread
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.warm_up import warm_up
from numpy.typing import NDArray
from plant_validation import FEED, JOB, RATE, drive, spiral


def form(step: float, share: float) -> tuple[int, float, float, int, Array]:
    """Points, CPU time s, that in coarse solutions, their number, CPU time s of every point; ``share`` of the depth."""
    rig = load_rig("ren2018")
    plant = SheetPlant(rig.clamp, load_material("AA5754-O"), 1e-3, 5e-3, step, rig.tool_1.compliance)
    solving = [0.0]
    serve = plant.serve

    def timed(request: int, tip: Array) -> None:
        begin = time.process_time()
        serve(request, tip)
        solving[0] += time.process_time() - begin

    plant.serve = timed  # type: ignore[method-assign]
    tips = spiral(36e-3, np.radians(50), share * 21e-3, step, 5e-3, 0.5e-3)
    pull = np.zeros(2)
    each = np.empty(len(tips))
    started = time.process_time()
    for k, tip in enumerate(tips):
        begin = time.process_time()
        plant.move(tip, pull)
        each[k] = time.process_time() - begin
    return len(tips), time.process_time() - started, solving[0], plant.solutions, each


@dataclass(frozen=True)
class Ticks:
    """Wall time s of every tick; which did more than a tick; solutions, those a tick waited for, longest wait s;
    load of the computer per core."""

    each: Array
    work: NDArray[np.bool_]
    solutions: int
    late: int
    longest: float
    load: float

    def row(self) -> str:
        """Texts for the table."""
        p50, p99, most = 1e6 * np.percentile(self.each, [50, 99, 100])
        work = 1e6 * np.median(self.each[self.work]), 1e6 * self.each[self.work].max()
        return (
            f"median {p50:.0f} us, 99 % {p99:.0f} us, largest {most:.0f} us; work: {self.work.sum()} ticks, "
            f"median {work[0]:.0f} us, largest {work[1]:.0f} us; {self.solutions} solutions, {self.late} waited for, "
            f"longest {1e3 * self.longest:.1f} ms; load per core {self.load:.1f}"
        )


def ticks(count: int, *, real_time: bool, as_node: bool, priority: int = 0) -> Ticks:
    """``count`` ticks on circles with 25 mm radius, in a thread with the real-time ``priority``."""
    machine = SimulatedMachine(JobFile(JOB.format(material="AA5754-O", radius=5), Path()))
    machine.tare()
    plant, worker = machine.plant, machine.plant.worker
    worker.ahead, worker.priority = real_time, max(priority - 1, 0)
    park = np.array([0.0, 0.0, -0.1])
    drive(machine, (np.array([0.0, 0.0, 0.1]), park), (np.array([25e-3, 0.0, -4e-3]), park))
    plant.settle()  # the way down was not in real time
    worker.late, worker.longest = 0, 0.0
    served, serve = [0], plant.serve

    def counted(request: int, tip: Array) -> None:
        served[0] += 1
        serve(request, tip)

    plant.serve = counted  # type: ignore[method-assign]
    before, each, work = plant.solutions, np.empty(count), np.zeros(count, dtype=bool)
    interpreter = PeriodicThread(RATE, lambda period: None) if as_node else None
    begun = time.perf_counter()
    for k in range(count):
        turn = k * FEED / RATE / 25e-3
        tip = np.array([25e-3 * np.cos(turn), 25e-3 * np.sin(turn), -4e-3 - 0.5e-3 * turn / (2.0 * np.pi)])
        already = served[0]
        started = time.perf_counter()
        machine.tick(tip, park)
        each[k] = time.perf_counter() - started
        work[k] = served[0] > already
        if real_time:
            machine.between_ticks()  # as the node does when the readings are out
            left = begun + (k + 1) / RATE - time.perf_counter()
            time.sleep(max(0.0, left))  # this loop is the machine's clock; after a pause a tick costs more
    if interpreter is not None:
        interpreter.give_back()
    load = os.getloadavg()[0] / len(os.sched_getaffinity(0))
    return Ticks(each, work, plant.solutions - before, worker.late, worker.longest, load)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--step", type=float, default=0.2, help="depth per loop, mm")
    parser.add_argument("--repeat", type=int, default=2)
    parser.add_argument("--ticks", type=int, default=10000, help="control ticks, 0: none")
    parser.add_argument("--fifo", type=int, default=0, help="real-time priority of the ticks, 0: ordinary")
    arguments = parser.parse_args()
    warm_up()
    form(arguments.step * 1e-3, 0.1)  # kernels from the cache
    measured = []
    for share in (0.5, 1.0):
        runs = [form(arguments.step * 1e-3, share) for _ in range(arguments.repeat)]
        points, total, solving, solutions, each = min(runs, key=lambda run: run[1])
        measured.append((points, total))
        p50, p99 = 1e6 * np.percentile(each, [50, 99])
        print(
            f"{points} points: {total:.2f} s, {points / total:.0f} points/s; {solutions} coarse solutions, "
            f"{100 * solving / total:.0f} % of the time, {1e3 * solving / solutions:.0f} ms each; "
            f"a point: median {p50:.0f} us, 99 % {p99:.0f} us, largest {1e3 * each.max():.0f} ms",
            flush=True,
        )
    (few, short), (many, long) = measured
    print(f"CPU time goes with the number of points to the power {np.log(long / short) / np.log(many / few):.2f}")
    if arguments.ticks and arguments.fifo:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(arguments.fifo))
    cases = (("lockstep", False, False), ("real time, interpreter as it is", True, False), ("real time", True, True))
    for name, real_time, as_node in cases if arguments.ticks else ():
        runs = [
            ticks(arguments.ticks, real_time=real_time, as_node=as_node, priority=arguments.fifo)
            for _ in range(arguments.repeat)
        ]
        best = min(runs, key=lambda run: float(np.percentile(run.each, 99)))
        print(f"{arguments.ticks} ticks in {name}: {best.row()}", flush=True)
    print(f"memory of the process at its largest: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
