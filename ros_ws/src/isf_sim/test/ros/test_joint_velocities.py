"""Velocities of the machine's joints where ticks were missed."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from isf_core.files.job import JobFile
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_sim.ros.joint_interface import JointInterface
from machine_client import JOB


def test_a_sample_after_missed_ticks_has_the_velocity_of_the_motion() -> None:
    """60 mm/s at 500 Hz; the fourth sample comes nine ticks after the third."""
    told: list[list[float]] = []
    publisher = SimpleNamespace(publish=lambda message: told.append(list(message.velocity)))
    node = SimpleNamespace(create_publisher=lambda *_: publisher, create_subscription=lambda *_: None)
    joints = JointInterface(node, lambda command: None)  # type: ignore[arg-type]
    file = JobFile(JOB, Path())
    joints.clamp(file)
    sample = SimulatedMachine(file).sample()
    for tick in (1, 2, 3, 12, 13, 13):
        moved = sample._replace(tick=tick, tip_1=sample.tip_1 - [0.0, 0.0, 0.12e-3 * tick])
        joints.publish(moved, 2_000_000 * tick)
    heights = [max(row, key=abs) for row in told]
    assert [abs(value) for value in heights] == pytest.approx([0.0, 0.06, 0.06, 0.06, 0.06, 0.0])
