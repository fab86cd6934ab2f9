"""The sheet over a rising die: what loops enclose rises with it whole, the flange hangs from its edge to the clamp."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.files.job import JobFile
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.types import Array
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine
from isf_sim.plant_constants import PlantConstants
from isf_sim.sheet.die_plant import DiePlant

COARSE = PlantConstants(coarse_cell=250e-3 / 16, fine_cell=1e-3)
JOB = """
name: over-a-die
part: {mesh: none.stl, unit: mm}
process: TPIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
die: {mesh: die.stl, unit: mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
control: {rate: 500 Hz}
"""
PARK = np.array([0.0, 0.0, -0.1])


@pytest.fixture
def plant() -> DiePlant:
    """A blank over nothing yet."""
    rig = load_rig("ren2018")
    return DiePlant(rig.clamp, load_material("AA5754-O"), 1e-3, 5e-3, 0.5e-3, rig.tool_1.compliance, constants=COARSE)


def die_of(plant: DiePlant, radius: float = 20e-3) -> Array:
    """(ny, nx) m, a flat die of ``radius`` m under the middle of the flat blank."""
    x = plant.surface.x0 + plant.surface.h * np.arange(plant.surface.height.shape[1])
    return np.where(np.hypot(*np.meshgrid(x, x)) < radius, -1e-3, -np.inf)


def walk(plant: DiePlant, radii: Array, height: float, way: float = 0.4e-3) -> None:
    """Once round with ``radii`` (2,) m at its start and end, every ``way`` m."""
    count = int(np.ceil(2 * np.pi * radii.max() / way))
    for turn in np.linspace(0.0, 2 * np.pi, count + 1):
        r = radii[0] + (radii[1] - radii[0]) * turn / (2 * np.pi)
        plant.move(np.array([r * np.cos(turn), r * np.sin(turn), height]), np.zeros(2))
        plant.note()


def test_what_the_tool_has_walked_round_rises_whole_however_finely_the_holder_moves(plant: DiePlant) -> None:
    """A loop of 40 mm beside a die of 20 mm: the unsupported part in between rises by all of the holder's steps."""
    die, middle = die_of(plant), plant.surface.height.shape[0] // 2
    plant.rise(die, 0.0)
    assert np.abs(plant.surface.height).max() == 0.0
    walk(plant, np.full(2, 40e-3), -6e-3)
    before = plant.surface.height.copy()
    for offset in np.arange(0.1e-3, 1.01e-3, 0.1e-3):
        plant.rise(die, float(offset))
    change = plant.surface.height - before
    assert change[middle, middle + 25 : middle + 40] == pytest.approx(1e-3)
    assert plant.surface.height[middle, middle] == pytest.approx(1e-3)  # on the die
    assert not plant.walked.any()


def test_a_tool_that_only_holds_the_sheet_down_encloses_it_too(plant: DiePlant) -> None:
    """Level with the flange it presses nothing, yet the flange cannot rise past it; 2 mm above it can."""
    die, middle = die_of(plant), plant.surface.height.shape[0] // 2
    plant.rise(die, 0.0)
    walk(plant, np.full(2, 40e-3), 2e-3)
    plant.rise(die, 0.5e-3)
    assert not plant.part.any()
    free = plant.surface.height[middle, middle + 30]
    assert 0.0 < free < 0.4e-3  # it hangs from the die to the clamp
    plant.rise(die, 0.0)
    walk(plant, np.full(2, 40e-3), 0.0)
    before = plant.surface.height[middle, middle + 30]
    plant.rise(die, 0.5e-3)
    assert plant.surface.height[middle, middle + 30] == pytest.approx(before + 0.5e-3, abs=1e-9)


@pytest.mark.parametrize(("ends", "way", "closed"), [(0.0, 6e-3, True), (1.2e-3, 0.4e-3, True), (9e-3, 0.4e-3, False)])
def test_ticks_far_apart_and_turns_of_a_spiral_are_loops(
    plant: DiePlant, ends: float, way: float, closed: bool
) -> None:
    """Ticks 6 mm apart on nodes of 1 mm; a turn whose ends are 1.2 mm apart closes, one with 9 mm does not."""
    plant.rise(die_of(plant), 0.0)
    walk(plant, np.array([40e-3, 40e-3 + ends]), -1e-3, way)
    plant.rise(die_of(plant), 0.1e-3)
    middle = plant.surface.height.shape[0] // 2
    assert plant.part[middle, middle] == closed


def test_flange_hangs_between_part_and_clamp(plant: DiePlant) -> None:
    """Nowhere above the part's edge or below the clamp; the mean of its neighbours wherever nothing holds it."""
    die = die_of(plant)
    plant.rise(die, 0.0)
    walk(plant, np.full(2, 40e-3), 0.0)
    plant.rise(die, 1e-3)
    z, middle = plant.surface.height, plant.surface.height.shape[0] // 2
    line = z[middle, middle + 46 : -1]
    assert (np.diff(line) < 0.0).all()
    assert 0.8e-3 < line[0] < 1e-3
    assert z[[0, -1]].max() == z[:, [0, -1]].max() == 0.0
    b = plant.flange
    mean = 0.25 * (b[:-2, 1:-1] + b[2:, 1:-1] + b[1:-1, :-2] + b[1:-1, 2:])
    away = np.hypot(*np.meshgrid(*[np.linspace(-125e-3, 125e-3, len(b))] * 2))[1:-1, 1:-1] > 46e-3
    assert np.abs(b[1:-1, 1:-1] - mean)[away].max() < 1e-6


def test_a_machine_over_a_die_is_taken_up_again_as_it_was(tmp_path: Path) -> None:
    """Saved between two loops: what they enclose is part of the state."""
    die = trimesh.creation.cylinder(radius=20.0, height=10.0)
    die.apply_translation([0.0, 0.0, -6.0])
    die.export(tmp_path / "die.stl")
    machine = SimulatedMachine(JobFile(JOB, tmp_path), constants=COARSE)
    machine.tare()
    above = machine.sample().tip_1
    for share in np.linspace(0.0, 1.0, 800):
        machine.tick(above + share * (np.array([26e-3, 0.0, 0.0]) - above), PARK)

    def loop(cell: SimulatedMachine, r: float, holder: float) -> Array:
        for turn in np.linspace(0.0, 2 * np.pi, 800):
            cell.tick(np.array([r * np.cos(turn), r * np.sin(turn), 0.0]), PARK, holder)
        return cell.measured_shape().z

    loop(machine, 26e-3, -0.05e-3)
    again = load_machine(save_machine(machine, tmp_path / "machine.npz"))
    after = loop(machine, 26e-3, -0.15e-3)
    assert machine.faults == []
    assert after.max() > 0.1e-3
    assert np.array_equal(loop(again, 26e-3, -0.15e-3), after)
