"""The first contours of the small example cone on the simulated machine, for measurements between contours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.files.job import JobFile
from isf_force_ctrl import ControlConfig, ForceController
from isf_planner import Plan, plan
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine

EXAMPLES = Path(__file__).resolve().parents[4] / "examples" / "jobs"


class PlantCell:
    """Machine and controller in one process; ``changes`` are replacements in the text of the job."""

    def __init__(
        self,
        kind: type[ForceController] = ForceController,
        *,
        seed: int = 0,
        seam_speed: float = float("inf"),
        **changes: str,
    ) -> None:
        text = (EXAMPLES / "mini_cone.yaml").read_text()
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        self.job_file = JobFile(text, EXAMPLES)
        self.plan: Plan = plan(self.job_file)
        self.machine = SimulatedMachine(self.job_file, seed=seed)
        self.machine.tare()
        self.sample: MachineSample = self.machine.sample()
        self.config = replace(ControlConfig.from_job(self.job_file), seam_speed=seam_speed)
        self.controller: Any = kind(self.config)
        park = self.config.park_height
        self.controller.arm(self.plan.plan_id, 0, len(self.plan.contours), (0, 0, park), (0, 0, -park))

    def form(self, count: int) -> None:
        """The first ``count`` contours."""
        for contour in self.plan.contours[:count]:
            self.controller.start(contour)
            self.run()
            assert self.controller.take_result().completed

    def run(self, ticks: int = 100_000) -> np.ndarray:
        """(T, 6) m targets until the controller rests, or for ``ticks``."""
        targets = []
        for _ in range(ticks):
            if not self.controller.busy:
                break
            sample = self.sample
            pair = self.controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
            self.sample = self.machine.tick(pair.tip_1, pair.tip_2, pair.holder_height)
            targets.append([*pair.tip_1, *pair.tip_2])
        assert not self.machine.faults
        return np.array(targets)
