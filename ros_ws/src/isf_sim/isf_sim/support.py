"""Rigid one-sided supports under the sheet (backing plate, die) for the coarse shell.

The lower face of the sheet lies one blank thickness below its upper face, measured vertically: volume constancy
thins a wall to t0 cos(alpha) along its normal, which is t0 along z. The support is sampled at points inside the
coarse cells, several to a cell, so that the edge of an opening is resolved finer than the cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from isf_sim.shell import Shell
from isf_sim.shell_assembly import SupportPoints
from isf_sim.surface import Surface

Array = NDArray[np.float64]

POINTS_PER_SIDE = 4
"""Points to a coarse cell, along x and along y."""
STIFFNESS = 3.3e10
"""N/m^3, penalty of the support: 2 N/um on a cell of 7.8 mm, some twenty times the sheet's own bending stiffness."""


def support_points(shell: Shell, surface: Surface) -> SupportPoints | None:
    """Points of ``surface.support`` (upper face of a sheet at rest on it) under the cells of ``shell``.

    None when no part of the support lies under the shell.
    """
    inner = (np.arange(POINTS_PER_SIDE) + 0.5) / POINTS_PER_SIDE
    b, a = (grid.ravel() for grid in np.meshgrid(inner, inner, indexing="ij"))
    share = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], axis=1)
    cells = (shell.nx - 1) * (shell.ny - 1)
    row, column = np.divmod(np.arange(cells), shell.nx - 1)
    x = shell.x[column][:, None] + a * shell.cell_x[:, None]
    y = shell.y[row][:, None] + b * shell.cell_y[:, None]
    ny, nx = surface.height.shape
    i = np.clip(np.rint((x - surface.x0) / surface.h).astype(int), 0, nx - 1)
    j = np.clip(np.rint((y - surface.y0) / surface.h).astype(int), 0, ny - 1)
    height = surface.support[j, i]
    chosen = np.isfinite(height)
    if not chosen.any():
        return None
    clearance = (surface.height[j, i] - height - surface.holder[1])[chosen]
    stiffness = np.broadcast_to((STIFFNESS * shell.cell_x * shell.cell_y / len(a))[:, None], x.shape)[chosen]
    return SupportPoints(
        cell=np.repeat(np.arange(cells, dtype=np.int32), len(a)).reshape(cells, -1)[chosen],
        share=np.broadcast_to(share, (cells, *share.shape))[chosen],
        clearance=clearance,
        stiffness=stiffness,
    )
