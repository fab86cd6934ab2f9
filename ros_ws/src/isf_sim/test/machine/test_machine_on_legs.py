"""The hexapod in the simulated machine: true and measured tip, saved state, faults that end in a coded hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.rig import load_rig
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine
from isf_sim.plant_constants import PlantConstants

JOB = """
name: legs
part: {mesh: none.stl, unit: mm}
process: SPIF
rig: RIG
sheet: {material: AA1050, thickness: 1 mm}
tool_1: {radius: 5 mm}
path: {incremental_depth: 1 mm, point_spacing: 1 mm, feed: 40 mm/s}
"""
COARSE = PlantConstants(coarse_cell=190e-3 / 16, fine_cell=1e-3)
PARK_1, PARK_2 = np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, -0.1])
LOW = np.array([0.0, 0.0, -3e-3])


def make(
    folder: Path, *faults: dict[str, object], cables_limit: str = "2 mm", supply: dict[str, object] | None = None
) -> SimulatedMachine:
    legs = {"faults": list(faults), "cables": {"limit": cables_limit}, "supply": supply or {}}
    rig = {"based_on": "torrao2013", "name": "hexapod", "legs": legs}
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    return SimulatedMachine(JobFile(JOB.replace("RIG", str(folder / "rig.yaml")), folder), constants=COARSE)


def go(machine: SimulatedMachine, start: np.ndarray, goal: np.ndarray, ticks: int) -> None:
    for k in range(1, ticks + 1):
        machine.tick(start + k / ticks * (goal - start), PARK_2)


def test_the_sheet_is_formed_by_the_true_tip_and_told_by_the_measured_one(tmp_path: Path) -> None:
    machine = make(tmp_path)
    machine.tare()
    assert machine.legs is not None
    assert machine.legs.following() == (0.0, 0.0)  # nothing touched yet
    go(machine, PARK_1, LOW, 1200)
    saved = save_machine(machine, tmp_path / "state")
    go(machine, LOW, LOW + [0.01, 0.0, 0.0], 250)
    for _ in range(100):
        sample = machine.hold()
    assert machine.faults == []
    assert sample.true_force_1[2] > 100.0
    assert sample.tip_1 == pytest.approx(LOW + [0.01, 0.0, 0.0], abs=30e-6)
    rms, largest = machine.legs.following()
    assert 0.0 < rms < largest < 100e-6  # starts and stops at once
    names, (strokes, _, pushes) = machine.legs.names, machine.legs.motion()
    assert names == ("L1", "L2", "L3", "L4", "L5", "L6")
    assert 0.0 < strokes.min() < strokes.max() < 0.4
    weights = (30.0 + 300.0 / 9.80665) * 9.80665
    upward = sample.true_force_1[2] - weights - 6 * 8.0 * 9.80665
    # the legs push what the sheet pushes up, less the weights that hang on them; friction of the seals beside it
    assert pushes.sum() == pytest.approx(upward, abs=6 * 80.0 + 100.0)

    again = load_machine(saved)
    go(again, LOW, LOW + [0.01, 0.0, 0.0], 250)
    for _ in range(100):
        other = again.hold()
    for mine, theirs in zip(sample, other, strict=True):
        if isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(mine, theirs)


def test_legs_tilt_the_tool_about_its_ball(tmp_path: Path) -> None:
    """Eight degrees within two seconds and back: the tip stays, the measured axis follows the one asked for."""
    machine = make(tmp_path)
    machine.tare()
    assert machine.legs is not None
    angles = np.radians(8.0) * np.concatenate([np.sin(np.linspace(0.0, np.pi / 2, 1000)) ** 2, np.ones(300)])
    for angle in angles:
        sample = machine.tick(PARK_1, PARK_2, axis=(0.0, -np.sin(angle), np.cos(angle)))
    assert machine.faults == []
    assert sample.axis_1 == pytest.approx((0.0, -np.sin(np.radians(8.0)), np.cos(np.radians(8.0))), abs=2e-4)
    assert sample.tip_1 == pytest.approx(PARK_1, abs=50e-6)
    assert machine.legs.tip() == pytest.approx(PARK_1, abs=50e-6)
    for angle in [*angles[999::-1], *np.zeros(300)]:
        sample = machine.tick(PARK_1, PARK_2, axis=(0.0, -np.sin(angle), np.cos(angle)))
    assert machine.faults == []
    assert sample.axis_1 == (0.0, 0.0, 1.0)


CASES = {
    "valve_stuck": ErrorCode.LEG_NOT_FOLLOWING,
    "encoder_range": ErrorCode.ENCODER_RANGE,
    "encoder_offset": ErrorCode.ENCODERS_DISAGREE,
    "pump_stop": ErrorCode.SUPPLY_PRESSURE,
    "power_loss": ErrorCode.POWER_LOST,
    "emergency_stop": ErrorCode.STOP_REQUESTED,
}


@pytest.mark.parametrize(("kind", "code"), CASES.items())
def test_a_fault_of_the_legs_is_a_coded_hold(tmp_path: Path, kind: str, code: ErrorCode) -> None:
    fault: dict[str, object] = {"kind": kind, "after": "1 s"}
    if kind in ("valve_stuck", "encoder_range", "encoder_offset"):
        fault["leg"] = 2
    if kind == "encoder_offset":
        fault["value"] = "0.9 mm"
    machine = make(tmp_path, fault, cables_limit="0.5 mm")
    for k in range(1500):
        machine.tick(PARK_1 - [0.0, 0.0, 8e-5 * min(k, 700)], PARK_2)
        if machine.faulted:
            break
    assert [found for found, _ in machine.faults] == [code]
    assert 500 <= machine.tick_count < 1300
    before = machine.sample().tip_1
    machine.release()  # no leg can be moved: it looks on, and ends
    for _ in range(50):
        sample = machine.tick(before + [0.02, 0.0, 0.0], PARK_2)  # targets are ignored
    sunk = before[2] - sample.tip_1[2]
    # beside a valve that is open and stays so, the weight draws oil through it
    assert np.linalg.norm(sample.tip_1[:2] - before[:2]) < (20e-3 if kind == "valve_stuck" else 5e-3)
    if kind == "power_loss":
        assert 1e-3 < sunk < 50e-3
    assert machine.faults[0][1]
    machine.reset()
    if kind in ("pump_stop", "power_loss", "emergency_stop"):  # mended: it goes on from where it is
        here = machine.sample().tip_1
        for k in range(400):
            machine.tick(here + [0.0, 0.0, 2e-5 * k], PARK_2)
        assert machine.faults == []
        assert machine.sample().tip_1[2] > here[2] + 7e-3
    elif kind == "encoder_range":
        machine.hold()
        assert [found for found, _ in machine.faults] == [code]  # still broken


def test_oil_that_gets_too_hot_is_a_coded_hold(tmp_path: Path) -> None:
    """The pump heats 197.4 kJ/K with 4.52 kW: 0.05 K in 2.2 s, without what the cooler takes."""
    machine = make(tmp_path, supply={"ambient": "25 degC", "warm": "25.02 degC", "hottest": "25.05 degC"})
    for _ in range(3000):
        machine.tick(PARK_1, PARK_2)
        if machine.faulted:
            break
    assert [found for found, _ in machine.faults] == [ErrorCode.OIL_HOT]
    assert machine.tick_count == pytest.approx(2.2 * machine.control_rate, rel=0.1)


def test_out_of_reach_is_refused_and_held(tmp_path: Path) -> None:
    rig = {
        "based_on": "torrao2013",
        "name": "wide",
        "limits": {"travel": ["115 mm", "115 mm", "600 mm"], "speed": "50 m/s"},
    }
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    machine = SimulatedMachine(JobFile(JOB.replace("RIG", str(tmp_path / "rig.yaml")), tmp_path), constants=COARSE)
    machine.tick(PARK_1 + [0.0, 0.0, 0.15], PARK_2)
    assert machine.faults[0][0] is ErrorCode.TARGET_OUT_OF_WORKSPACE
    assert "cylinder" in machine.faults[0][1]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"faults": [{"kind": "valve_stuck"}]}, "faults"),
        ({"faults": [{"kind": "pump_stop", "leg": 2}]}, "faults"),
        ({"faults": [{"kind": "encoder_offset", "leg": 2}]}, "faults"),
        ({"cylinder": {"rod": "63 mm"}}, "cylinder"),
        ({"supply": {"lowest_pressure": "200 bar"}}, "supply"),
        ({"controller": "pid"}, "controller"),
        ({"valve": {"flow": "12 mm"}}, "flow"),
    ],
)
def test_bad_legs_are_refused_with_the_field(tmp_path: Path, change: dict[str, object], field: str) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"based_on": "torrao2013", "name": "bad", "legs": change}))
    with pytest.raises(IsfError) as caught:
        load_rig(str(tmp_path / "rig.yaml"))
    assert caught.value.code in (ErrorCode.FILE_FIELD, ErrorCode.FILE_UNIT)
    assert field in caught.value.message


def test_a_gantry_has_no_legs(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"based_on": "ren2018", "name": "bad", "legs": {}}))
    with pytest.raises(IsfError) as caught:
        load_rig(str(tmp_path / "rig.yaml"))
    assert "gantry" in caught.value.message
