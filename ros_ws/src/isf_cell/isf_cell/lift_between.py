"""The tool lift between two contours: how it is made, in one process and by the action of a cell, and what it told.

Both give rows (K, 4): x, y, z of the loaded and lifting tip in m and the axial force in N, the first of the tool at
rest on the sheet, the last where the force vanishes; no rows when the measurement failed.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import ContourResult
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_force_ctrl.measurements.tool_lift import LiftSettings
from isf_force_ctrl.measuring_controller import MeasuringController
from isf_sim.machine.simulated_machine import MachineSample, SimulatedMachine

from isf_cell.ticks import run_ticks

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
