"""Set-points that differ from wall to wall, from the job to the true force on the simulated machine."""

from __future__ import annotations

import numpy as np
import pytest
from isf_core.files.job import JobFile
from isf_force_ctrl import ControlConfig, ForceController, Mode
from isf_planner import plan
from isf_sim.machine.simulated_machine import SimulatedMachine
from plant_cell import EXAMPLES

RULES = "\n  force_rules: [{facing: [45 deg, 225 deg], force: 200 N}]\nspringback:"


@pytest.fixture(scope="module")
def force() -> np.ndarray:
    """(T, 2) N, wanted and true normal force at every tick under control of two contours, 100 N and 200 N by half."""
    text = (EXAMPLES / "mini_cone.yaml").read_text().replace("support_force: 120 N", "support_force: 100 N")
    job_file = JobFile(text.replace("\nspringback:", RULES), EXAMPLES)
    contours = plan(job_file).contours
    machine = SimulatedMachine(job_file)
    machine.tare()
    controller = ForceController(ControlConfig.from_job(job_file))
    sample = machine.sample()
    controller.arm(contours[0].plan_id, 0, len(contours), sample.tip_1.tolist(), sample.tip_2.tolist())
    rows: list[tuple[float, float]] = []
    for contour in contours[:6]:
        controller.start(contour)
        while controller.busy:
            before = controller.targets
            pair = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            if contour.index >= 4 and controller.mode is Mode.CONTROL:
                away = np.subtract(before.tip_2[:2], before.tip_1[:2])
                wanted = 200.0 if away[1] > away[0] else 100.0
                rows.append((wanted, float(away @ sample.true_force_2[:2] / np.hypot(*away))))
            sample = machine.tick(pair.tip_1, pair.tip_2, pair.holder_height)
        controller.take_result()
    return np.array(rows)


def test_steps_between_walls_settle_within_0_3_s(force: np.ndarray) -> None:
    """100 to 200 N and back: within 10 N after 0.3 s, overshoot of 10 N at most, and held until the next step."""
    wanted, true = force.T
    steps = np.flatnonzero(np.diff(wanted)) + 1
    assert len(steps) == 4  # two contours, each up and down
    for begin, end in zip(steps, [*steps[1:], len(wanted)], strict=True):
        goal = wanted[begin]
        settled = true[begin + 150 : end]
        assert np.abs(settled - goal).max() <= 10.0
        beyond = (true[begin:end] - goal) * (1.0 if goal > 150.0 else -1.0)
        assert beyond.max() <= 10.0
