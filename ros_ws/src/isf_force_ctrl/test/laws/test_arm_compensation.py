"""Compensation of a tool on an arm: the offset is against what the arm gives, and no faster or larger than allowed."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.rig import load_rig
from isf_core.geometry.serial_arm import compliance_field
from isf_force_ctrl.control_state import Flag
from isf_force_ctrl.laws.arm_compensation import ArmCompensation
from isf_force_ctrl.laws.force_and_compliance import ComplianceSettings, low_pass

RATE = 250.0
OWN = (0.05e-6, 0.05e-6, 0.01e-6)


def make(factor: float = 1.0, *, limit: float = 3e-3, slew: float = 7e-3) -> ArmCompensation:
    rig = load_rig("kr210_arm")
    arm = rig.arm(1)
    assert arm is not None
    field = tuple(compliance_field(arm, rig.limits.travel).ravel().tolist())
    settings = ComplianceSettings(RATE, (0.0, 0.0), low_pass(50.0, RATE), slew, limit, 0.2)
    return ArmCompensation(settings, field, OWN, factor)


def settle(law: ArmCompensation, force: tuple[float, float, float], tip: tuple[float, float, float]) -> np.ndarray:
    for _ in range(1000):
        law.step(force, (0.6, 0.8), tip, (0.0, 0.0))
    return np.array([law.x, law.y, law.z])


@pytest.mark.parametrize("tip", [(0.0, 0.0, 0.0), (0.1, -0.1, -0.08)])
def test_the_offset_cancels_what_joints_and_tool_give(tip: tuple[float, float, float]) -> None:
    """The arm's give is taken from its joints: each turns by its torque, and the tip is where the arm then has it."""
    arm = load_rig("kr210_arm").arm(1)
    assert arm is not None
    force = np.array([60.0, -40.0, 700.0])
    joints = arm.held(np.array(tip))[0]
    step = 1e-6
    levers = np.array(
        [
            (arm.forward(joints + step * np.eye(6)[k])[0] - arm.forward(joints - step * np.eye(6)[k])[0]) / (2 * step)
            for k in range(6)
        ]
    )
    stiffness = np.array([1.5e6, 3.3e6, 2.5e6, 0.33e6, 0.30e6, 0.42e6])
    gives = arm.forward(joints + levers @ force / stiffness)[0] - np.array(tip) + np.array(OWN) * force
    offset = settle(make(), (60.0, -40.0, 700.0), tip)
    assert np.linalg.norm(gives) > 0.6e-3
    assert np.linalg.norm(offset + gives) < 0.01 * np.linalg.norm(gives)
    assert settle(make(0.5), (60.0, -40.0, 700.0), tip) == pytest.approx(0.5 * offset, rel=1e-6)


def test_limits_of_size_and_speed_hold_and_are_told() -> None:
    law = make(limit=0.2e-3, slew=7e-3)
    law.step((0.0, 0.0, 2000.0), (1.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0))
    first = law.z
    assert abs(first) <= 7e-3 / RATE + 1e-12
    offset = settle(law, (0.0, 0.0, 2000.0), (0.0, 0.0, 0.0))
    assert offset[2] == pytest.approx(-0.2e-3)
    assert law.flags == int(Flag.SATURATED_COMPLIANCE)
    law.freeze()
    assert law.flags == 0
    assert law.z == pytest.approx(-0.2e-3)


def test_another_factor_comes_without_a_jump() -> None:
    law, other = make(), make(0.0)
    before = settle(law, (0.0, 0.0, 500.0), (0.0, 0.0, 0.0))
    rig = load_rig("kr210_arm")
    arm = rig.arm(1)
    assert arm is not None
    field = tuple(compliance_field(arm, rig.limits.travel).ravel().tolist())
    law.retune(ComplianceSettings(RATE, (0.0, 0.0), low_pass(50.0, RATE), 7e-3, 3e-3, 0.2), field, OWN, 0.0)
    law.step((0.0, 0.0, 500.0), (0.6, 0.8), (0.0, 0.0, 0.0), (0.0, 0.0))
    assert abs(law.z - before[2]) <= 7e-3 / RATE + 1e-12
    assert settle(law, (0.0, 0.0, 500.0), (0.0, 0.0, 0.0)) == pytest.approx(
        settle(other, (0, 0, 500.0), (0, 0, 0)), abs=1e-12
    )
