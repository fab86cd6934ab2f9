"""The tool lift after a contour: how it is made, and its unloading curve as springback reads it."""

from __future__ import annotations

import numpy as np
from isf_core.contour import ContourResult
from isf_core.types import Array
from isf_force_ctrl.measurements.tool_lift import LiftSettings

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
