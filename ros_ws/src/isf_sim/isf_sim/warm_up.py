"""Compile every kernel once, so that nodes and tests start at once: ``python -m isf_sim.warm_up``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from isf_core.job import JobFile

from isf_sim.machine import SimulatedMachine

_JOB = """
name: warm-up
part: {mesh: none.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
"""


def warm_up() -> float:
    """Press a tool into a blank and scan it; returns the wall time, s. Kernels found in the cache cost little."""
    started = time.perf_counter()
    machine = SimulatedMachine(JobFile(_JOB, Path()))
    plant = machine.plant
    machine.tare()
    machine.tick(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1]))
    pull = np.zeros(2)
    for angle in np.linspace(0.0, 4.0 * np.pi, 120):  # a few loops, so that the base follows too
        plant.move(np.array([6e-3 * np.cos(angle), 6e-3 * np.sin(angle), -5e-3]), pull)
    machine.measured_shape()
    accumulative = SimulatedMachine(JobFile(_JOB.replace("DSIF", "ADSIF"), Path()))
    accumulative.tick(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1]))
    return time.perf_counter() - started


if __name__ == "__main__":
    print(f"kernels of the simulated machine ready in {warm_up():.1f} s", file=sys.stderr)
