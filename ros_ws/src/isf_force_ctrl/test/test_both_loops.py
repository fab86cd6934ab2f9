"""Force control and compliance compensation at once on the simulated machine, against each alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_force_ctrl import ControlConfig, ForceController, Mode
from isf_planner import plan
from isf_sim.machine.simulated_machine import SimulatedMachine
from plant_cell import EXAMPLES

FIRST, LAST = 4, 6
"""Contours of the small cone that are looked at: under force control, radius about 11 mm, 2.5 rad/s at 30 mm/s."""


@dataclass(frozen=True)
class Formed:
    """Per tick: how far the forming ball is off its path across it, m, outward; true normal force, N."""

    off: np.ndarray
    force: np.ndarray


def formed(force: float, factor: float) -> Formed:
    job_file = JobFile((EXAMPLES / "mini_cone.yaml").read_text(), EXAMPLES)
    contours = plan(job_file).contours
    machine = SimulatedMachine(job_file)
    machine.tare()
    config = replace(ControlConfig.from_job(job_file, support_force=force), compensation=factor)
    controller = ForceController(config)
    sample = machine.sample()
    controller.arm(contours[0].plan_id, 0, len(contours), sample.tip_1.tolist(), sample.tip_2.tolist())
    compliance = np.array(job_file.rig.tool_1.compliance[:2])
    off, forces = [], []
    for contour in contours[:LAST]:
        controller.start(contour)
        while controller.busy:
            pair = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            if contour.index >= FIRST and controller.mode in (Mode.CONTROL, Mode.POSITION):
                tip = sample.tip_1[:2] + compliance * sample.true_force_1[:2]
                off.append(np.linalg.norm(tip) - radius(contour))
                forces.append(tip @ sample.true_force_2[:2] / np.linalg.norm(tip))
            sample = machine.tick(pair.tip_1, pair.tip_2, pair.holder_height)
        result = controller.take_result()
        assert result is not None
        assert result.completed
    return Formed(np.array(off), np.array(forces))


def radius(contour: Contour) -> float:
    return float(np.linalg.norm(contour.forming_tip[:, :2], axis=1).mean())


@pytest.fixture(scope="module")
def runs() -> dict[str, Formed]:
    return {"force": formed(120.0, 0.0), "compensation": formed(0.0, 1.0), "both": formed(120.0, 1.0)}


def test_the_tool_stays_on_its_path_with_both_loops(runs: dict[str, Formed]) -> None:
    """Force control alone lets the forming tool give way to the squeeze; with compensation 95 % of it are gone."""
    alone, both = np.abs(runs["force"].off).mean(), np.abs(runs["both"].off).mean()
    assert alone > 100e-6  # 120 N at 1 um/N
    assert both < 0.05 * alone
    assert both < np.abs(runs["compensation"].off).mean() + 1e-6


def test_the_force_is_held_with_both_loops(runs: dict[str, Formed]) -> None:
    for name in ("force", "both"):
        error = np.abs(runs[name].force - 120.0)
        assert np.mean(error <= 10.0) >= 0.999
        assert np.sqrt(np.mean(error**2)) <= 3.0
    # compensation alone squeezes by what the gap happens to be
    assert runs["compensation"].force.std() > 3.0 * runs["both"].force.std()
