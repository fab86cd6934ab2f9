"""The cell in one process: control ticks, and the tool lift and the scan between contours.

Counterpart of :mod:`isf_cell.run.graph_cell`, which takes from here how a lift is made and where the tools go aside.
SI units, frame ``sheet``.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour, ContourResult
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_force_ctrl.measurements.tool_lift import LiftSettings
from isf_force_ctrl.measuring_controller import MeasuringController
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine


def run_ticks(controller: MeasuringController, machine: SimulatedMachine, sample: MachineSample) -> MachineSample:
    """Tick from ``sample`` until the controller rests; the last sample.

    A fault of the machine, which holds from then on, ends what the controller is doing with the machine's code.
    """
    while controller.busy:
        if machine.faults and controller.fault is None:
            controller.fail(*machine.faults[0], ticking=True)
        targets = controller.tick(sample.tick, sample.time, sample.wrench_1.tolist(), sample.wrench_2.tolist())
        sample = machine.tick(targets.tip_1, targets.tip_2, targets.holder_height)
    return sample


SETTINGS = LiftSettings(speed=5e-3, zero_force=5.0, max_lift=12e-3)
"""Slow against the forming feed, threshold of two to three steps of a load cell, more than twice any published
springback (assumed)."""

NO_ROWS = np.empty((0, 4))


def lift_rows(result: ContourResult, springback: float, force: float, lift_z: Array, lift_force: Array) -> Array:
    """Rows of a lift at the last point of the contour of ``result``; lift_z, lift_force (K,) of the way there and back.

    ``springback`` m and ``force`` N as the force controller tells them.
    """
    if not np.isfinite(springback) or not len(lift_z) or not len(result.forming_target):
        return NO_ROWS
    x, y = result.forming_target[-1, :2]
    up = float(np.sign(springback)) or 1.0
    top = int(np.argmax(up * lift_z)) + 1
    begin = float(lift_z[0])
    z = np.concatenate([[begin], lift_z[:top], [begin + springback]])
    forces = np.concatenate([[abs(force)], np.abs(lift_force[:top]), [0.0]])
    return np.column_stack([np.full(len(z), x), np.full(len(z), y), z, forces])


def lift_in_process(
    controller: MeasuringController, machine: SimulatedMachine, sample: MachineSample, result: ContourResult
) -> tuple[Array, MachineSample]:
    """Lift the tool after the contour of ``result``; the rows and the sample after it."""
    try:
        lift = controller.lift_tool(SETTINGS)
    except IsfError:  # the tools are not on the sheet, as between two features
        return NO_ROWS, sample
    sample = run_ticks(controller, machine, sample)
    if lift.code is not ErrorCode.OK:
        return NO_ROWS, sample
    found = lift.record()
    return lift_rows(result, found.springback, found.force, found.lift_z, found.lift_force), sample


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
