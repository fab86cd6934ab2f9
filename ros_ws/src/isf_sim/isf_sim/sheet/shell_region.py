"""Where the coarse shell needs small cells: the region that is formed, as it becomes known.

A backing plate tells it by its opening. Otherwise it grows with the places that the tool has pressed, so it is known
after the first contour and nothing about the planned part is asked for.
"""

from __future__ import annotations

import numpy as np
from isf_core.types import Array

from isf_sim.sheet.surface import Surface
from isf_sim.shell.shell import Shell
from isf_sim.shell.shell_lines import Grading, graded_lines

MARGIN = 7.0e-3
"""m, small cells beyond the place of the tool: as far as its spread load reaches."""
MINIMUM_MARGIN = 4.0e-3
"""m, the region grows when the tool is nearer to its border than this."""


def no_region() -> Array:
    """(2, 2) m, low and high end of the region along x and y; empty."""
    return np.array([[np.inf, -np.inf], [np.inf, -np.inf]])


def grow_region(region: Array, x: float, y: float) -> bool:
    """Let ``region`` (2, 2) m take in the tool at (x, y) m; False when it does already."""
    ends = region.tolist()  # faster than arrays of four, and asked in a tick
    if all(
        at - low >= MINIMUM_MARGIN and high - at >= MINIMUM_MARGIN for at, (low, high) in zip((x, y), ends, strict=True)
    ):
        return False
    place = np.array([[x], [y]])
    region[:, 0] = np.where(place[:, 0] - region[:, 0] >= MINIMUM_MARGIN, region[:, 0], place[:, 0] - MARGIN)
    region[:, 1] = np.where(region[:, 1] - place[:, 0] >= MINIMUM_MARGIN, region[:, 1], place[:, 0] + MARGIN)
    return True


def opening_region(surface: Surface) -> Array | None:
    """(2, 2) m, the opening of the support under ``surface``; None when it has none or is open at the clamp."""
    open_ = ~np.isfinite(surface.support)
    if open_[[0, -1]].any() or open_[:, [0, -1]].any() or not open_.any():
        return None
    columns, rows = np.flatnonzero(open_.any(axis=0)), np.flatnonzero(open_.any(axis=1))
    return np.array(
        [
            [start + surface.h * found[0] - MINIMUM_MARGIN, start + surface.h * found[-1] + MINIMUM_MARGIN]
            for start, found in ((surface.x0, columns), (surface.y0, rows))
        ]
    )


def region_lines(shell: Shell, region: Array, grading: Grading) -> tuple[Array, Array]:
    """(nx,), (ny,) m, lines for ``region`` (2, 2) m."""
    x, y = (
        graded_lines(2.0 * float(lines[-1]), len(lines) - 1, float(ends[0]), float(ends[1]), grading)
        for lines, ends in zip((shell.x, shell.y), region, strict=True)
    )
    return x, y
