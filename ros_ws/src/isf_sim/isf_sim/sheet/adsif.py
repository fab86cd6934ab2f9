"""Accumulative double-sided forming: two tools at constant height spiral outwards and carry the part down.

Local law: the ring that the tools form now gets the stable wall angle of their position angle theta and of the gap
that is left when both tools have given way (Ren 2018, chapter 3):

    a_s = acos(1 - p0 (1 - Tg)^p4), a_b = p1 (1 - exp(-theta / p2)), alpha = (a_s^p3 + a_b^p3)^(1/p3)   [deg]
    Tg = Tg_commanded + sin(theta) (C_1 + C_2) F_h(Tg) / t0

Five parameters fitted to the 19 published stable angles (rms 0.64 deg). The height follows from the slopes by
lap z = div(tan(alpha) n_out), z = 0 at the clamp: everything inside a ring moves with it, and angles that differ round
a loop tilt the base. Not modelled: the over-bend while the tools pass, elastic recovery, sheets of other t0 / R.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from scipy.fft import dstn, idstn

from isf_sim.jit import kernel
from isf_sim.sheet.surface import Surface

ANGLE_LAW = (0.5912, 38.873, 44.393, 6.797, 1.2046)
"""p0 to p4, fitted to the stable angles of Ren 2018, 3.2.3."""
FORCE_GAP = np.array([0.0, 0.60, 0.70, 0.74, 0.78, 0.80, 0.90, 1.00, 1.30])
FORCE = np.array([7620.0, 1500.0, 480.0, 285.0, 200.0, 175.0, 130.0, 100.0, 0.0])
"""N, horizontal force of each tool over the gap / t0. About 100 N at 1.0, 1500 N at 0.6 and less than 500 N from 0.8
are published trends; 0.74 and 0.78 are calibrated on the two measured angles of about 28 deg; the rest is assumed."""
STEEPEST_THETA, FLATTEST_THETA = math.radians(70.0), math.radians(10.0)

STABLE, BUCKLES, FREE = 0, 1, 2
"""What :func:`form_ring` returns."""


class AdsifConstants(NamedTuple):
    """Blank thickness m, radii m, horizontal compliance m/N of both tools together, force level, width m of the ring
    that one point forms."""

    thickness: float
    radius_1: float
    radius_2: float
    compliance: float
    force_level: float
    width: float


class Adsif(NamedTuple):
    """State: slope (2, ny, nx) of the formed sheet on the grid of ``surface``; local (4,): wall angle rad, gap / t0,
    theta rad, horizontal force N of the last tick; force (3,) N of the sheet on the support tool."""

    slope: Array
    local: Array
    force: Array


def no_ring(surface: Surface) -> Adsif:
    """A flat blank."""
    return Adsif(np.zeros((2, *surface.height.shape)), np.zeros(4), np.zeros(3))


@kernel
def stable_angle(gap: float, theta: float) -> float:
    """rad, wall angle for gap / t0 and position angle theta rad."""
    p0, p1, p2, p3, p4 = ANGLE_LAW
    squeezed = math.degrees(math.acos(max(1.0 - p0 * max(1.0 - gap, 0.0) ** p4, -1.0)))
    bent = p1 * (1.0 - math.exp(-math.degrees(theta) / p2))
    return math.radians((squeezed**p3 + bent**p3) ** (1.0 / p3))


@kernel
def horizontal_force(gap: float) -> float:
    """N, of each tool, for gap / t0; linear in the table."""
    if gap <= FORCE_GAP[0]:
        return FORCE[0]
    for k in range(1, FORCE_GAP.shape[0]):
        if gap <= FORCE_GAP[k]:
            share = (gap - FORCE_GAP[k - 1]) / (FORCE_GAP[k] - FORCE_GAP[k - 1])
            return FORCE[k - 1] + share * (FORCE[k] - FORCE[k - 1])
    return 0.0


@kernel
def opened_gap(gap: float, theta: float, constants: AdsifConstants) -> float:
    """Gap / t0 when both tools have given way under the force of just that gap (commanded gap / t0)."""
    give = math.sin(theta) * constants.compliance * constants.force_level / constants.thickness
    low, high = gap, gap + give * FORCE[0]
    for _ in range(60):
        middle = 0.5 * (low + high)
        if middle - gap - give * horizontal_force(middle) < 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def is_unstable(gap: float, theta: float) -> bool:
    """The sheet buckles between the tools: gap / t0 below 0.6, below 0.7 at theta up to 25 deg (Ren 2018, 3.2.3)."""
    return gap < 0.6 or (gap < 0.7 and theta <= math.radians(25.0))


@kernel
def form_ring(tip_1: Array, tip_2: Array, surface: Surface, state: Adsif, constants: AdsifConstants) -> int:
    """Form the sheet between the true tips (3,), (3,) m; returns STABLE, BUCKLES or FREE (no contact)."""
    state.force[:] = 0.0
    state.local[:] = 0.0
    dx, dy = tip_2[0] - tip_1[0], tip_2[1] - tip_1[1]
    down = (tip_1[2] + constants.radius_1) - (tip_2[2] - constants.radius_2)
    across = math.sqrt(dx * dx + dy * dy)
    theta = math.atan2(across, down)
    if not (FLATTEST_THETA < theta < STEEPEST_THETA) or tip_1[2] >= 0.0:
        return FREE
    distance = math.sqrt(across * across + down * down)
    gap = opened_gap((distance - constants.radius_1 - constants.radius_2) / constants.thickness, theta, constants)
    size = constants.force_level * horizontal_force(gap)
    if size <= 0.0:
        return FREE
    nx, ny = dx / across, dy / across
    angle = stable_angle(gap, theta)
    state.force[0], state.force[1], state.force[2] = size * nx, size * ny, -size / math.tan(theta)
    state.local[0], state.local[1], state.local[2], state.local[3] = angle, gap, theta, size
    # the wall leaves the forming ball where its normal is the ball's
    x, y = tip_1[0] + constants.radius_1 * math.sin(angle) * nx, tip_1[1] + constants.radius_1 * math.sin(angle) * ny
    _write(x, y, math.tan(angle) * nx, math.tan(angle) * ny, surface, state, constants.width)
    return BUCKLES if is_unstable(gap, theta) else STABLE


@kernel
def _write(x: float, y: float, sx: float, sy: float, surface: Surface, state: Adsif, width: float) -> None:
    rows, columns = surface.height.shape
    i0, i1 = int((x - width - surface.x0) / surface.h), int((x + width - surface.x0) / surface.h) + 2
    j0, j1 = int((y - width - surface.y0) / surface.h), int((y + width - surface.y0) / surface.h) + 2
    for j in range(max(j0, 1), min(j1, rows - 1)):
        for i in range(max(i0, 1), min(i1, columns - 1)):
            across, along = surface.x0 + i * surface.h - x, surface.y0 + j * surface.h - y
            # outwards of the tools the sheet is still flat
            if across * across + along * along <= width * width and across * sx + along * sy <= 0.0:
                state.slope[0, j, i], state.slope[1, j, i] = sx, sy
                surface.formed[j, i] = 1


def accumulated_height(state: Adsif, h: float) -> Array:
    """(ny, nx) m, least-squares surface of the slopes with z = 0 along the border: lap z = div g, sine transform."""
    along_x = 0.5 * (state.slope[0, :, 1:] + state.slope[0, :, :-1])
    along_y = 0.5 * (state.slope[1, 1:, :] + state.slope[1, :-1, :])
    source = (np.diff(along_x, axis=1)[1:-1] + np.diff(along_y, axis=0)[:, 1:-1]) / h
    rows, columns = source.shape
    kx = 2.0 * np.cos(np.pi * np.arange(1, columns + 1) / (columns + 1)) - 2.0
    ky = 2.0 * np.cos(np.pi * np.arange(1, rows + 1) / (rows + 1)) - 2.0
    inner = idstn(dstn(source, type=1) / ((kx[None, :] + ky[:, None]) / h**2), type=1)
    return np.pad(inner, 1)


def measured_shape(state: Adsif, surface: Surface, spacing: float = 1.0e-3) -> HeightMap:
    """Upper surface of the formed sheet on a grid of ``spacing`` m."""
    z = accumulated_height(state, surface.h)
    stride = max(1, round(spacing / surface.h))
    x = surface.x0 + surface.h * np.arange(0, z.shape[1], stride, dtype=np.float64)
    y = surface.y0 + surface.h * np.arange(0, z.shape[0], stride, dtype=np.float64)
    return HeightMap(x, y, np.ascontiguousarray(z[::stride, ::stride]))
