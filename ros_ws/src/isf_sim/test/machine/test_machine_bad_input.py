"""Bad input at the machine: a code is latched, the sheet keeps its shape, and the state can still be saved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import EventKind
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_sim.machine.simulated_machine import LIMIT_SPEED, LIMIT_TRAVEL, SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine
from isf_sim.plant_constants import PlantConstants

JOB = """
name: bad-input
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
PARK = np.array([0.0, 0.0, -0.1])


def make(job: str = JOB, folder: Path | None = None) -> SimulatedMachine:
    return SimulatedMachine(JobFile(job, folder or Path()), constants=COARSE)


def go(machine: SimulatedMachine, tip_1: Array, tip_2: Array = PARK) -> None:
    """Straight to the tips, 0.15 mm per tick, and 60 ticks of rest."""
    sample = machine.sample()
    starts, goals = (sample.tip_1, sample.tip_2), (np.asarray(tip_1, float), np.asarray(tip_2, float))
    steps = int(np.ceil(max(np.linalg.norm(g - s) for s, g in zip(starts, goals, strict=True)) / 0.15e-3))
    for k in range(1, steps + 61):
        share = min(k / steps, 1.0)
        machine.tick(*(s + share * (g - s) for s, g in zip(starts, goals, strict=True)))


@pytest.fixture(scope="module")
def formed() -> Callable[[], SimulatedMachine]:
    """A machine with a groove in its sheet and the tool lifted 2 mm clear of it, anew for every test."""
    machine = make()
    machine.tare()
    go(machine, np.array([0.0, 0.0, -7e-3]))
    for k in range(200):
        machine.tick(np.array([0.1e-3 * k, 0.0, -7e-3]), PARK)
    for _ in range(60):
        machine.hold()
    go(machine, np.array([20e-3, 0.0, 2e-3]))
    assert machine.faults == []
    state = machine.state_copy()

    def again() -> SimulatedMachine:
        machine.restore(state)
        return machine

    return again


HERE = np.array([20e-3, 0.0, 2e-3])


@pytest.mark.parametrize(
    ("targets", "code"),
    [
        ((HERE + [np.nan, 0, 0], PARK), ErrorCode.TARGET_NOT_FINITE),
        ((HERE, PARK + [0, -np.inf, 0]), ErrorCode.TARGET_NOT_FINITE),
        ((HERE + [1e-3, 0, 0], PARK), ErrorCode.TARGET_JUMP),
        ((HERE, PARK + [0, 0, 1e-3]), ErrorCode.TARGET_JUMP),
    ],
)
def test_a_wrong_target_is_latched_and_the_sheet_stays(
    formed: Callable[[], SimulatedMachine], targets: tuple[Array, Array], code: ErrorCode, tmp_path: Path
) -> None:
    machine = formed()
    before = machine.measured_shape().z
    assert before.min() < -0.2e-3
    machine.tick(*targets)
    assert [c for c, _ in machine.faults] == [code]
    for _ in range(50):
        machine.tick(HERE + [0, 0, -1e-4], PARK)  # ignored
    machine.release()
    assert np.array_equal(machine.measured_shape().z, before)
    again = load_machine(save_machine(machine, tmp_path / "state.npz"))
    assert np.array_equal(again.measured_shape().z, before)
    assert again.faults == machine.faults


def test_leaving_the_workspace(formed: Callable[[], SimulatedMachine]) -> None:
    machine = formed()
    before = machine.measured_shape().z
    for k in range(1, 800):
        machine.tick(HERE + [0.15e-3 * k, 0, 0], PARK)
    assert [c for c, _ in machine.faults] == [ErrorCode.TARGET_OUT_OF_WORKSPACE]
    assert machine.limits & LIMIT_TRAVEL
    assert machine.sample().tip_1[0] < 0.1255
    assert np.array_equal(machine.measured_shape().z, before)


def test_a_little_too_fast_is_a_limit_and_no_fault(formed: Callable[[], SimulatedMachine]) -> None:
    """0.3 mm per tick at 500 Hz is 150 mm/s; the limit is 100 mm/s, a jump begins at twice that."""
    machine = formed()
    machine.tick(HERE + [0.3e-3, 0, 0], PARK)
    assert machine.faults == []
    assert machine.limits & LIMIT_SPEED


def test_tools_that_would_collide(formed: Callable[[], SimulatedMachine]) -> None:
    machine = formed()
    before = machine.measured_shape().z
    go(machine, HERE, HERE + [0, 0, 8e-3])
    assert machine.faults[0][0] in (ErrorCode.TOOL_COLLISION, ErrorCode.FORCE_LIMIT)
    machine.release()
    assert not machine.loaded
    # the upper tool is clear, so the lower one lifts the sheet a little before the balls meet: 4 um stay
    assert np.abs(machine.measured_shape().z - before).max() < 0.02e-3


def test_force_beyond_range_saturates_the_cell_and_stops() -> None:
    machine = make()
    go(machine, np.array([0.0, 0.0, -30e-3]))
    assert machine.faults[0][0] in (ErrorCode.FORCE_LIMIT, ErrorCode.LOAD_CELL_RANGE)
    assert EventKind.SATURATION in [event.kind for event in machine.events]
    assert abs(machine.sample().true_force_1[2]) < 3000.0
    machine.release()
    assert not machine.loaded
    assert np.isfinite(machine.measured_shape().z).all()


def test_a_cell_with_too_small_a_range_is_a_fault_of_its_own(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[3] / "isf_core" / "rigs" / "ren2018.yaml").read_text()
    rig = text.replace("  force_range: [1500 N, 1500 N, 2000 N]", "  force_range: [50 N, 50 N, 50 N]")
    (tmp_path / "weak.yaml").write_text(rig)
    machine = make(JOB.replace("rig: ren2018", "rig: weak.yaml"), tmp_path)
    machine.tare()
    go(machine, np.array([0.0, 0.0, -5e-3]))
    assert [c for c, _ in machine.faults] == [ErrorCode.LOAD_CELL_RANGE]
    assert machine.sample().wrench_1[2] < 80.0 < machine.sample().true_force_1[2] + 80.0


def test_a_hexapod_is_reported_what_it_cannot_reach() -> None:
    job = JOB.replace("ren2018", "torrao2013").replace("DSIF", "SPIF").replace("tool_2: {radius: 5 mm}\n", "")
    machine = make(job)
    go(machine, np.array([0.05, 0.0, 0.09]))
    assert machine.faults == []
    machine._travel[:] = 1.0  # beyond the travel of the rig file, as far as the cylinders go
    go(machine, np.array([0.05, 0.0, 0.4]))
    assert [c for c, _ in machine.faults] == [ErrorCode.TARGET_OUT_OF_WORKSPACE]
    assert "cylinder" in machine.faults[0][1]


def test_a_blank_holder_height_that_is_none(formed: Callable[[], SimulatedMachine]) -> None:
    machine = formed()
    machine.tick(HERE, PARK, float("nan"))
    assert [c for c, _ in machine.faults] == [ErrorCode.TARGET_NOT_FINITE]
    assert machine.holder_height == 0.0


def test_tooling_that_does_not_fit_the_blank_is_refused_before_anything_moves() -> None:
    with pytest.raises(IsfError) as error:
        make(JOB + "backing_plate: {shape: circle, size: [260 mm, 260 mm]}\n")
    assert error.value.code == ErrorCode.BLANK_DOES_NOT_FIT
