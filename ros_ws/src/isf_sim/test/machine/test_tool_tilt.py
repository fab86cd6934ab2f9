"""The tilting tool of the simulated machine: refusals, servo, nine cells that tilt with it, a saved state."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile, load_job
from isf_core.geometry.tool_axis import UPRIGHT, inclination
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine

JOBS = Path(__file__).resolve().parents[5] / "examples" / "jobs"
PARKED = (0.0, 0.0, -0.1)
HIGH = (0.0, 0.0, 0.1)
DEG = np.pi / 180.0


@pytest.fixture(scope="module")
def job_file() -> JobFile:
    return load_job(JOBS / "torrao_cone_45_five_axis.yaml")


def leaning(tilt: float) -> tuple[float, float, float]:
    return (float(np.sin(tilt * DEG)), 0.0, float(np.cos(tilt * DEG)))


@pytest.mark.parametrize(
    ("rig", "axis", "code", "words"),
    [
        ("torrao2013", (0.0, 0.0, 0.0), ErrorCode.TARGET_NOT_FINITE, "is no direction"),
        ("torrao2013", (np.nan, 0.0, 1.0), ErrorCode.TARGET_NOT_FINITE, "is no direction"),
        ("torrao2013", leaning(35.0), ErrorCode.TARGET_OUT_OF_WORKSPACE, "can tilt it by 30.00 deg"),
        ("torrao2013", (0.0, 0.0, -1.0), ErrorCode.TARGET_OUT_OF_WORKSPACE, "tilted by 180.00 deg"),
        ("torrao2013", leaning(5.0), ErrorCode.TARGET_JUMP, "turns by 5.00 deg in one tick"),
        ("ren2018", leaning(0.5), ErrorCode.TARGET_OUT_OF_WORKSPACE, "can tilt it by 0.00 deg"),
    ],
)
def test_an_axis_that_cannot_be_is_a_fault_and_the_tool_stays(
    rig: str, axis: tuple[float, ...], code: ErrorCode, words: str, job_file: JobFile
) -> None:
    machine = SimulatedMachine(JobFile(job_file.text.replace("torrao2013", rig), job_file.base))
    park = machine.job_file.rig.park_height
    sample = machine.tick((0.0, 0.0, park), (0.0, 0.0, -park), axis=axis)
    assert machine.faults[0][0] == code
    assert words in machine.faults[0][1]
    assert sample.axis_1 == UPRIGHT


def test_the_tool_follows_its_cells_tilt_with_it_and_a_saved_state_goes_on(job_file: JobFile, tmp_path: Path) -> None:
    """0.02 deg a tick up to 20 deg, then at rest: the axis arrives, and the weight moves to the sides of the cells."""
    machine = SimulatedMachine(job_file)
    upright = machine.hold()
    for k in range(1, 1001):
        sample = machine.tick(HIGH, PARKED, axis=leaning(0.02 * k))
        if k == 500:
            again = load_machine(save_machine(machine, tmp_path / "state.npz"))
    for k in range(501, 1001):
        other = again.tick(HIGH, PARKED, axis=leaning(0.02 * k))
    for _ in range(400):
        sample, other = machine.tick(HIGH, PARKED, axis=leaning(20.0)), again.tick(HIGH, PARKED, axis=leaning(20.0))
    assert not machine.faults
    assert inclination(np.array(sample.axis_1)) == pytest.approx(20 * DEG, abs=1e-4)  # legs come to rest within 1 s
    assert other.axis_1 == sample.axis_1
    assert upright.volts_1 is not None
    assert sample.volts_1 is not None
    np.testing.assert_array_equal(other.volts_1, sample.volts_1)
    cells = job_file.rig.tool_1.spindle_cells
    assert cells is not None
    change = ((sample.volts_1 - upright.volts_1).reshape(3, 3) * cells.gain_array).sum(axis=0)
    weight = job_file.rig.tool_1.weight  # N; by hand: R^T (0, 0, -w) less (0, 0, -w)
    # R^T (0, 0, -w) with the axis (sin, 0, cos): x of the tool is (cos, 0, -sin)
    assert change == pytest.approx([weight * np.sin(20 * DEG), 0.0, weight * (1 - np.cos(20 * DEG))], abs=5.0)


@pytest.mark.parametrize(("shank", "collides"), [("shank_radius: 40 mm", True), ("shank_radius: 5 mm", False)])
def test_a_shank_that_runs_into_the_sheet_is_a_fault(shank: str, collides: bool, job_file: JobFile) -> None:
    """Tip 3 mm over the flat sheet, tilted by 15 deg: the edge of a shank of 40 mm is at 8 - 40 sin 15 = -2.4 mm."""
    text = job_file.text.replace("radius: 5 mm", f"radius: 5 mm\n  {shank}")
    machine = SimulatedMachine(JobFile(text, job_file.base))
    for k in range(1, 751):
        machine.tick(HIGH, PARKED, axis=leaning(0.02 * k))
    for k in range(1, 650):
        machine.tick((0.0, 0.0, max(3e-3, 0.1 - 0.18e-3 * k)), PARKED, axis=leaning(15.0))
    found = [code for code, _ in machine.faults]
    assert found == ([ErrorCode.TOOL_COLLISION] if collides else [])
    if collides:
        assert "the shank of the tilted tool has run into the sheet" in machine.faults[0][1]
