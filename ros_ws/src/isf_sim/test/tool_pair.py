"""Both tools on a simulated machine, driven by their roles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine
from isf_sim.plant_constants import PlantConstants

JOB = """
name: roles-test
part: {mesh: none.stl, unit: mm}
process: DSIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz}
"""
COARSE = PlantConstants(coarse_cell=250e-3 / 16, fine_cell=1e-3)
BLANK, RADIUS, ANGLE, STEP = 1e-3, 5e-3, np.radians(50.0), 0.5e-3
PARK = 0.1


@dataclass
class Pair:
    """Drives the tools by roles: ``side`` 1 forms with the upper tool, -1 is the same in the mirror of the sheet."""

    machine: SimulatedMachine
    forming: Array
    support: Array
    side: int = 1

    def to(self, forming: Array, support: Array) -> MachineSample:
        self.forming, self.support = forming, support
        if self.side == 1:
            return self.machine.tick(forming, support)
        return self.machine.tick(self.mirrored(support), self.mirrored(forming))

    @staticmethod
    def mirrored(tip: Array) -> Array:
        return np.array([tip[0], tip[1], -tip[2] - BLANK])

    def move(self, forming: Array, support: Array) -> MachineSample:
        first, second = self.forming, self.support
        way = max(np.linalg.norm(forming - first), np.linalg.norm(support - second))
        for share in np.linspace(0.0, 1.0, int(np.ceil(way / 0.15e-3)) + 1)[1:]:
            sample = self.to(first + share * (forming - first), second + share * (support - second))
        return sample


def start(side: int, machine: SimulatedMachine | None = None) -> Pair:
    if machine is None:
        machine = SimulatedMachine(JobFile(JOB, Path()), constants=COARSE)
        if side == -1:  # stiffness of the tools exchanged too, so that nothing but the side differs
            upper, lower = machine._constants, machine._turned_constants
            machine._turned_constants = lower._replace(point=upper.point, squeeze=upper.squeeze)
            machine.plant.sides = (upper.point, upper.point)
    forming, support = np.array([0.0, 0.0, PARK]), np.array([0.0, 0.0, -PARK])
    if side == 1:
        return Pair(machine, forming, support, side)
    return Pair(machine, Pair.mirrored(support), Pair.mirrored(forming), side)


def tips_of(centre: Array, opening: float, depth: float, angle: float) -> tuple[Array, Array]:
    """Planned tips at ``depth`` m of a cone wall round ``centre``: contact on the wall, gap by the sine law."""
    out = np.array([np.cos(angle), np.sin(angle), 0.0])
    normal = np.sin(ANGLE) * out - np.array([0.0, 0.0, np.cos(ANGLE)])
    contact = np.append(centre, -depth) + (opening - depth / np.tan(ANGLE)) * out
    ball = contact - RADIUS * normal
    other = ball + (2.0 * RADIUS + BLANK * np.cos(ANGLE)) * normal
    up = np.array([0.0, 0.0, RADIUS])
    return ball - up, other + up
