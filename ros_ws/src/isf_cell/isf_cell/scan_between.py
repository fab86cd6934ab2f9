"""The scan between two contours in one process: tools aside where the job wants it, then the shape."""

from __future__ import annotations

from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_force_ctrl.measuring_controller import MeasuringController
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine

from isf_cell.ticks import run_ticks


def tools_aside(job_file: JobFile, *, closed: bool) -> bool:
    """True when the tools leave the sheet for the scan after a contour that is ``closed`` or not."""
    return job_file.job.springback.scan_clear and closed


def scan_in_process(
    job_file: JobFile,
    contour: Contour,
    controller: MeasuringController,
    machine: SimulatedMachine,
    sample: MachineSample,
) -> tuple[Array, MachineSample]:
    """(P, 3) m, points of the upper surface in the clamp after ``contour``, and the sample after the scan."""
    if tools_aside(job_file, closed=contour.closed):
        controller.move_aside()
        sample = run_ticks(controller, machine, sample)
    if job_file.job.springback.scan_sensor:
        points = machine.measured_cloud(duration=not machine.moving)
    else:
        points = machine.measured_shape().points()
    return points, machine.sample()  # a scan takes its time
