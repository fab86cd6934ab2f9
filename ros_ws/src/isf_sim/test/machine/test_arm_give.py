"""Arms of the simulated machine: tips give way as the joints do, encoders do not see it, and states go on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode
from isf_core.files.job import JobFile
from isf_core.files.rig import load_rig
from isf_sim.machine.arm_give import ArmGive, with_arms
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.machine.state import load_machine, save_machine

EXAMPLES = Path(__file__).resolve().parents[5] / "examples" / "jobs"


def job_file() -> JobFile:
    return JobFile((EXAMPLES / "robot_cone.yaml").read_text(), EXAMPLES, "robot_cone.yaml")


def test_own_part_and_rest_are_the_compliance_together() -> None:
    """Levers and drives by hand: a force in z lifts the tip by 1.02 um/N and pushes it aside by 0.46 um/N."""
    plant = with_arms(job_file()).rig
    np.testing.assert_allclose(
        plant.tool_1.compliance, [0.05e-6 + 1.542e-6, 0.05e-6 + 2.733e-6, 0.01e-6 + 1.018e-6], rtol=1e-3
    )
    assert plant.tool_2.compliance == load_rig("kr210_arm").tool_2.compliance
    give, way = ArmGive(load_rig("kr210_arm"), 1.0, 250.0), np.zeros((2, 3))
    tips = np.zeros((2, 3))
    for _ in range(200):
        tips[:] = 0.0
        give.move(tips, (np.array([0.0, 0.0, 500.0]), np.zeros(3)), np.zeros(2), way)
    np.testing.assert_allclose(tips[0], [500.0 * 0.46113e-6, 0.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(tips[1], 0.0)


def test_the_rest_follows_at_the_arms_first_mode() -> None:
    give, way = ArmGive(load_rig("kr210_arm"), 1.0, 250.0), np.zeros((2, 3))
    tips = np.zeros((2, 3))
    give.move(tips, (np.array([0.0, 0.0, 500.0]), np.zeros(3)), np.zeros(2), way)
    # after one tick of 4 ms at 10 Hz: 1 - exp(-2 pi 0.04) of the end
    assert tips[0, 0] == pytest.approx((1.0 - np.exp(-0.08 * np.pi)) * 500.0 * 0.4611e-6, rel=1e-3)


def test_a_rig_without_arms_is_as_it_was() -> None:
    other = JobFile((EXAMPLES / "spif_cone.yaml").read_text(), EXAMPLES, "spif_cone.yaml")
    assert with_arms(other) is other
    assert not ArmGive(other.rig, 1.0, 500.0).present


def test_a_target_beyond_the_joints_is_a_fault(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[3] / "isf_core" / "rigs" / "kr210_arm.yaml").read_text()
    (tmp_path / "rig.yaml").write_text(text.replace("range: [-140 deg, -5 deg]", "range: [-77 deg, -76 deg]"))
    job = (EXAMPLES / "robot_cone.yaml").read_text().replace("kr210_arm", str(tmp_path / "rig.yaml"))
    machine = SimulatedMachine(JobFile(job, EXAMPLES, "robot_cone.yaml"))
    tip = np.array([0.0, 0.0, 0.1])
    for _ in range(400):
        tip = tip - np.array([0.0, 0.0, 0.2e-3])
        machine.tick(tip, np.array([0.0, 0.0, -0.1]))
        if machine.faulted:
            break
    assert machine.faults[0][0] is ErrorCode.TARGET_OUT_OF_WORKSPACE
    assert "joint A2 would stand at" in machine.faults[0][1]


def test_a_state_taken_up_goes_on_bit_by_bit() -> None:
    machine = SimulatedMachine(job_file())
    tip = np.array([0.0, 0.0, 0.1])
    for _ in range(600):
        tip = tip - np.array([0.0, 0.0, 0.17e-3])
        machine.tick(tip, np.array([0.0, 0.0, -0.1]))
    assert not machine.faulted
    kept = machine.state_copy()
    first = [machine.tick(tip, np.array([0.0, 0.0, -0.1])) for _ in range(20)]
    machine.restore(kept)
    second = [machine.tick(tip, np.array([0.0, 0.0, -0.1])) for _ in range(20)]
    assert abs(first[-1].true_force_1[2]) > 50.0
    assert all(
        np.array_equal(a.true_force_1, b.true_force_1) and np.array_equal(a.wrench_1, b.wrench_1)
        for a, b in zip(first, second, strict=True)
    )
    np.testing.assert_allclose(first[-1].tip_1, tip, atol=1e-5)  # the encoders


def test_a_saved_machine_goes_on_bit_by_bit(tmp_path: Path) -> None:
    """Saved 1 mm after its compliance was found, which another 1.5 mm do not find anew."""
    machine, below = SimulatedMachine(job_file()), np.array([0.0, 0.0, -0.1])
    tip = np.array([0.0, 0.0, 0.1])
    for _ in range(600):
        tip = tip - np.array([0.0, 0.0, 0.17e-3])
        machine.tick(tip, below)
    found = machine._arms.at[0].copy()
    while np.array_equal(machine._arms.at[0], found):
        tip = tip + np.array([0.1e-3, 0.0, 0.0])
        machine.tick(tip, below)
    for _ in range(8):
        tip = tip + np.array([0.1e-3, 0.0, 0.0])
        machine.tick(tip, below)
    kept = machine.state_copy()
    file = save_machine(machine, tmp_path / "arm.npz")

    def goes_on(machine: SimulatedMachine) -> np.ndarray:
        way = tip + np.arange(1, 60)[:, None] * np.array([0.1e-3, 0.0, 0.0])
        return np.array(
            [[*sample.true_force_1, *machine._axes.tips[0]] for sample in (machine.tick(at, below) for at in way)]
        )

    once = goes_on(machine)
    assert not machine.faulted
    assert abs(once[-1, 2]) > 50.0
    assert np.array_equal(goes_on(load_machine(file)), once)
    machine.restore(kept)
    assert np.array_equal(goes_on(machine), once)
