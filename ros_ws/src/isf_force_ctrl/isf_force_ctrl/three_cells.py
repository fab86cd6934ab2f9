"""Forces from three tri-axial cells at 120 degrees between platform and spindle, with a fall-back (Torrao 2013, 3.4.1).

The spindle is a lever of height H on a circle of radius R: horizontal forces show in the axial channels, and again in
the shear channels. Either reading can check the other, and any one cell may fail. Cell 1 stands at 0, cell 2 at 120,
cell 3 at -120 degrees; axial readings are positive for an upward force on the tool. Forces are in axes of the platform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

Array = NDArray[np.float64]

RADIUS = 0.110
"""m, of the circle of cells (published)."""


@dataclass(frozen=True)
class ThreeCellForce:
    """``force`` (3,) N: horizontal x, y and vertical; ``shear`` (2,) N: horizontal by the shear channels;
    ``inconsistency`` N: how far the two disagree, NaN when a cell is missing; ``missing``: cell without signal or 0."""

    force: Array
    shear: Array
    inconsistency: float
    missing: int


def decomposition(height: float, radius: float = RADIUS) -> Array:
    """(3, 3), horizontal x, y and vertical force from the three axial readings (eq. 3.3-3.6); lengths in m."""
    lever, root = radius / height, np.cos(np.radians(30.0))
    return np.array([[lever, -lever / 2, -lever / 2], [0.0, lever * root, -lever * root], [1.0, 1.0, 1.0]])


def force_of(readings: Array, height: float, radius: float = RADIUS) -> ThreeCellForce:
    """Force on the tool from ``readings`` (3, 3) N: rows are cells, columns x, y, axial; one row may be NaN.

    Raises IsfError WRENCH_NOT_FINITE when more than one cell is missing.
    """
    readings = np.asarray(readings, dtype=float)
    dead = ~np.isfinite(readings).all(axis=1)
    if dead.sum() > 1:
        raise IsfError(
            ErrorCode.WRENCH_NOT_FINITE,
            f"load cells {', '.join(str(k + 1) for k in np.flatnonzero(dead))} give no reading",
            advice="one of the three cells may fail, not two",
        )
    if not dead.any():
        force = decomposition(height, radius) @ readings[:, 2]
        shear = readings[:, :2].sum(axis=0)
        return ThreeCellForce(force, shear, float(np.linalg.norm(force[:2] - shear)), 0)
    lost = int(np.argmax(dead))
    shear = 1.5 * readings[~dead, :2].sum(axis=0)
    axial = readings[:, 2].copy()
    lever, root = radius / height, np.cos(np.radians(30.0))
    if lost == 0:
        axial[0] = (shear[0] + 0.5 * lever * (axial[1] + axial[2])) / lever
    elif lost == 1:
        axial[1] = axial[2] + shear[1] / (lever * root)
    else:
        axial[2] = axial[1] - shear[1] / (lever * root)
    return ThreeCellForce(np.array([*shear, axial.sum()]), shear, float("nan"), lost + 1)


def readings_of(force: Array, height: float, radius: float = RADIUS) -> Array:
    """(3, 3) N, readings under ``force`` (3,) N (eq. 3.7, 3.8-3.10): the shear is shared equally."""
    axial = np.linalg.solve(decomposition(height, radius), np.asarray(force, dtype=float))
    return np.column_stack([np.full(3, force[0] / 3), np.full(3, force[1] / 3), axial])
