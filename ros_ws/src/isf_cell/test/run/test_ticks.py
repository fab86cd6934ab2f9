"""Controller and machine in one process: a fault of the machine ends what the controller does."""

from __future__ import annotations

from pathlib import Path

from isf_cell.run.cell_wrenches import CellWrenches
from isf_cell.run.in_process_cell import run_ticks
from isf_core.errors import ErrorCode
from isf_core.files.job import load_job
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.controller import ForceController
from isf_planner import plan
from isf_sim.machine.simulated_machine import SimulatedMachine

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"


def test_a_faulted_machine_does_not_complete_a_contour() -> None:
    """The machine holds where it is from its fault on; the controller hears of it, instead of moving on alone."""
    job_file = load_job(JOB)
    part = plan(job_file)
    machine = SimulatedMachine(job_file)
    machine.tare()
    controller = ForceController(ControlConfig.from_job(job_file))
    sample = machine.sample()
    controller.arm(part.plan_id, 0, len(part.contours), sample.tip_1.tolist(), sample.tip_2.tolist())
    controller.start(part.contours[0])
    machine.latch(ErrorCode.TARGET_OUT_OF_WORKSPACE, "outside")
    run_ticks(controller, machine, sample, CellWrenches(machine))
    result = controller.take_result()
    assert result is not None
    assert (result.completed, result.code) == (False, int(ErrorCode.TARGET_OUT_OF_WORKSPACE))
    assert result.message == "outside"
