"""The flange round a part over a die: what no tool has walked round yet hangs between its edge and the clamp.

The counterpart of :mod:`isf_sim.sheet.base_following`: outside the last loop the flange B satisfies lap B = 0 with
B = 0 at the clamp and B = height of the sheet on the edge of the loop and where the die carries it. Bending is left
out, as it is there.
"""

from __future__ import annotations

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.sheet.surface import Surface, bilinear

RELAXATION = 1.9
LARGEST_SWEEPS = 400
ACCURACY = 1.0e-7
"""m, change per sweep at which the flange is settled."""


def follow(surface: Surface, held: NDArray[np.bool_], flange: Array, stride: int) -> None:
    """Hang the flange of ``surface`` anew.

    ``held`` (ny, nx) fine nodes that are part or lie on the die; ``flange`` (my, mx) m, height on every ``stride``-th
    fine node, start and result.
    """
    fixed = np.empty(flange.shape, dtype=np.bool_)
    _take_edge(surface.height, held, stride, flange, fixed)
    _relax(flange, fixed)
    _hang(surface, held, flange, stride)


@kernel
def _take_edge(height: Array, held: NDArray[np.bool_], stride: int, flange: Array, fixed: NDArray[np.bool_]) -> None:
    """Coarse nodes with a held fine node within half a cell stand at the lowest of these; the clamp stands at 0."""
    ny, nx = height.shape
    my, mx = flange.shape
    half = stride // 2
    for b in range(my):
        for a in range(mx):
            fixed[b, a] = b in (0, my - 1) or a in (0, mx - 1)
            if fixed[b, a]:
                flange[b, a] = 0.0
                continue
            lowest = np.inf
            for j in range(max(b * stride - half, 0), min(b * stride + half + 1, ny)):
                for i in range(max(a * stride - half, 0), min(a * stride + half + 1, nx)):
                    if held[j, i]:
                        lowest = min(lowest, height[j, i])
            if np.isfinite(lowest):
                fixed[b, a] = True
                flange[b, a] = lowest


@kernel
def _relax(flange: Array, fixed: NDArray[np.bool_]) -> None:
    """Successive over-relaxation of lap B = 0."""
    my, mx = flange.shape
    for _ in range(LARGEST_SWEEPS):
        largest = 0.0
        for b in range(1, my - 1):
            for a in range(1, mx - 1):
                if not fixed[b, a]:
                    mean = 0.25 * (flange[b - 1, a] + flange[b + 1, a] + flange[b, a - 1] + flange[b, a + 1])
                    change = RELAXATION * (mean - flange[b, a])
                    flange[b, a] += change
                    largest = max(largest, abs(change))
        if largest < ACCURACY:
            break


@kernel
def _hang(surface: Surface, held: NDArray[np.bool_], flange: Array, stride: int) -> None:
    """Put the fine nodes that are not held onto B."""
    ny, nx = surface.height.shape
    spacing = stride * surface.h
    for j in range(1, ny - 1):
        for i in range(1, nx - 1):
            if not held[j, i]:
                value = bilinear(flange, 0.0, 0.0, spacing, i * surface.h, j * surface.h)
                surface.height[j, i] = value
                surface.before[j, i] = value
