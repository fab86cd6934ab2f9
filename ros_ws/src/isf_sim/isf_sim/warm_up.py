"""Compile every kernel once, so that nodes and tests start at once: ``python -m isf_sim.warm_up``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from isf_core import warm_up as core
from isf_core.files.job import JobFile

from isf_sim.machine.events import EventBounds, wall_strain
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.sheet.die_plant import DiePlant
from isf_sim.sheet.sheet_plant import SheetPlant
from isf_sim.sheet.squeeze import no_squeeze
from isf_sim.sheet.thickness import strain_up_the_wall
from isf_sim.sheet.turned_sheet import turn_over

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
    """Press tools into blanks from either side and over a die; returns the wall time, s. Cached kernels cost little."""
    started = time.perf_counter()
    core.warm_up()
    machine = SimulatedMachine(JobFile(_JOB, Path()))
    plant = machine.plant
    machine.tare()
    machine.tick(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1]))
    _go_round(plant)
    contact, tip = plant.contact, plant.contact.formed_tip
    strain_up_the_wall(plant.surface, tip[0], tip[1], contact.wall, plant.radius, 1.0, 0.0, np.zeros(3))
    bounds = EventBounds(0.0, 1.0, 1.0, 0.0, 0.0, plant.radius, plant.radius, plant.thickness)
    wall_strain(plant.surface, contact, no_squeeze(), plant.radius, 0.0, bounds, np.zeros(3))  # as an event is told
    machine.measured_shape()
    turn_over(plant, np.array([0.0, 0.0, 0.02]))
    _go_over_a_die(machine)
    accumulative = SimulatedMachine(JobFile(_JOB.replace("DSIF", "ADSIF"), Path()))
    accumulative.tick(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1]))
    hexapod = _JOB.replace("DSIF", "SPIF").replace("ren2018", "torrao2013").replace("tool_2: {radius: 5 mm}\n", "")
    SimulatedMachine(JobFile(hexapod, Path())).tick(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1]))
    return time.perf_counter() - started


def _go_round(plant: SheetPlant) -> None:
    """Two loops wide enough to have a base that follows."""
    for angle in np.linspace(0.0, 4.0 * np.pi, 240):
        plant.move(np.array([15e-3 * np.cos(angle), 15e-3 * np.sin(angle), -5e-3]), np.zeros(2))


def _go_over_a_die(machine: SimulatedMachine) -> None:
    """The same over a die in the middle that has come up once."""
    rig, sheet = machine.job_file.rig, machine.plant
    plant = DiePlant(rig.clamp, sheet.material, sheet.thickness, sheet.radius, 0.5e-3, rig.tool_1.compliance)
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in plant.surface.height.shape), indexing="ij")
    die = np.where(np.hypot(x, y) < 0.05, -plant.thickness, -np.inf)
    plant.rise(die, 0.0)
    _go_round(plant)
    plant.note()
    plant.rise(die, 0.5e-3)


if __name__ == "__main__":
    print(f"kernels of the simulated machine ready in {warm_up():.1f} s", file=sys.stderr)
