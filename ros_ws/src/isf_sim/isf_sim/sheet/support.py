"""Rigid one-sided supports under the sheet (backing plate, die) for the coarse shell.

The lower face of the sheet lies one blank thickness below its upper face, measured vertically: volume constancy
thins a wall to t0 cos(alpha) along its normal, which is t0 along z. The support is sampled at points inside the
coarse cells, several to a cell, so that the edge of an opening is resolved finer than the cell.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.sheet.surface import Surface
from isf_sim.shell.shell import Shell
from isf_sim.shell.shell_assembly import SupportPoints

POINTS_PER_SIDE = 4
"""Points to a coarse cell, along x and along y."""
_INNER = (np.arange(POINTS_PER_SIDE) + 0.5) / POINTS_PER_SIDE
STIFFNESS = 3.3e10
"""N/m^3, penalty of the support: 2 N/um on a cell of 7.8 mm, some twenty times the sheet's own bending stiffness."""


class Under(NamedTuple):
    """Sheet and support at the points of the coarse cells, POINTS_PER_SIDE times as many rows and columns as cells.

    ``sheet`` m, height of the unloaded sheet ; ``support`` m, as in Surface, -inf where there is none ; ``rise`` m, of
    the support
    """

    sheet: Array
    support: Array
    rise: float


def sample_under(surface: Surface, x: Array, y: Array) -> Under:
    """What stands under ``surface`` for a shell with the lines x, y m."""
    ny, nx = surface.height.shape
    place = np.ix_(_nearest(y.tobytes(), surface.y0, surface.h, ny), _nearest(x.tobytes(), surface.x0, surface.h, nx))
    return Under(surface.height[place], surface.support[place], float(surface.holder[1]))


@lru_cache(maxsize=16)
def _nearest(lines: bytes, start: float, h: float, count: int) -> NDArray[np.int64]:
    """Fine nodes nearest to the points inside the cells between the lines (n,) m, as bytes."""
    places = np.frombuffer(lines)
    points = places[:-1, None] + _INNER * np.diff(places)[:, None]
    return np.clip(np.rint((points.ravel() - start) / h).astype(np.int64), 0, count - 1)


def support_points(shell: Shell, under: Under) -> SupportPoints | None:
    """Points of the support (upper face of a sheet at rest on it) under the cells of ``shell``.

    None when no part of the support lies under the shell.
    """
    count = int(np.isfinite(under.support).sum())
    if count == 0:
        return None
    points = SupportPoints(
        cell=np.empty(count, dtype=np.int32),
        share=np.empty((count, 4)),
        clearance=np.empty(count),
        stiffness=np.empty(count),
    )
    _fill(under, shell.nx - 1, shell.cell_x, shell.cell_y, points)
    return points


@kernel
def _fill(under: Under, cells_x: int, dx: Array, dy: Array, points: SupportPoints) -> None:
    n, side = 0, POINTS_PER_SIDE
    for cell in range(len(dx)):
        row, column = side * (cell // cells_x), side * (cell % cells_x)
        stiffness = STIFFNESS * dx[cell] * dy[cell] / (side * side)
        for k in range(side):
            b = (k + 0.5) / side
            for m in range(side):
                standing = under.support[row + k, column + m]
                if not np.isfinite(standing):
                    continue
                a = (m + 0.5) / side
                points.cell[n] = cell
                points.share[n, 0], points.share[n, 1] = (1.0 - a) * (1.0 - b), a * (1.0 - b)
                points.share[n, 2], points.share[n, 3] = (1.0 - a) * b, a * b
                points.clearance[n] = under.sheet[row + k, column + m] - standing - under.rise
                points.stiffness[n] = stiffness
                n += 1
