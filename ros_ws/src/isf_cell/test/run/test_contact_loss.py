"""Contact of the support tool on the plant: lost under position control, later with compensation, kept by control.

Ren 2018, 2.4.1 and 2.4.3: contact is lost the later the more of the compliance is compensated.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.files.job import load_job
from isf_force_ctrl import ControlConfig, ForceController
from isf_planner import plan
from isf_sim.machine.simulated_machine import SimulatedMachine
from isf_springback.corrector import apply
from isf_springback.methods import make_corrector

pytestmark = pytest.mark.slow

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "ren_cone.yaml"
CONTOURS = 17


def first_loss(force: float, compensation: float) -> int:
    """Index of the contour on which contact is lost: the support tool had it, and has it on less than half the points.

    The first contour of the part presses alone: it makes up for the springback of the flat sheet at once.
    """
    job_file = load_job(JOB)
    part = plan(job_file)
    machine = SimulatedMachine(job_file)
    machine.tare()
    config = replace(ControlConfig.from_job(job_file, support_force=force), compensation=compensation)
    controller = ForceController(config)
    sample = machine.sample()
    controller.arm(part.plan_id, 0, len(part.contours), sample.tip_1.tolist(), sample.tip_2.tolist())
    method = make_corrector("analytic", job_file)
    had_contact = False
    for nominal in part.contours[:CONTOURS]:
        contour = apply(nominal, method.correct(nominal))
        controller.start(contour)
        while controller.busy:
            targets = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            sample = machine.tick(targets.tip_1, targets.tip_2)
        result = controller.take_result()
        assert result is not None
        assert result.completed
        method.add_result(contour, result)
        contact = bool(np.mean(np.linalg.norm(result.support_force[:, :2], axis=1) > 5.0) >= 0.5)
        if had_contact and not contact:
            return contour.index
        had_contact = had_contact or contact
    return CONTOURS


def test_contact_is_lost_later_with_compensation_and_never_with_force_control() -> None:
    none, half, full = (first_loss(0.0, factor) for factor in (0.0, 0.5, 1.0))
    assert none < half < full < CONTOURS
    assert first_loss(120.0, 1.0) == CONTOURS
