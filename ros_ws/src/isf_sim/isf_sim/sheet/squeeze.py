"""Squeeze of the sheet between the two tools: a self-equilibrated pair of forces along the line of centres.

gap = |c2 - c1| - R1 - R2 with c1 deflected by the sheet's force; overlap d0 = t - gap;
F_n = d0 / (1/k_m + n.(C1 + C2) n) for d0 > 0, else 0 (contact lost). k_m = 0.5 pi R* 2.8 s_f with
R* = 2 R1 R2/(R1 + R2): plastic indentation between two balls. The largest force seen thins the sheet for good.

What is squeezed yields under less tension, so the forming tool needs less force and the sheet bends less: see
:func:`eased_tension`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.types import Array

from isf_sim.jit import kernel
from isf_sim.sheet.sheet_point import TRAVELLED, Contact
from isf_sim.sheet.surface import Surface, corner_of

SQUEEZED_THINNEST = 0.2
"""Share of its former thickness that squeezing leaves of the sheet at least."""


class SqueezeConstants(NamedTuple):
    """Tool radii m, stiffness k_m N/m, lasting part of the indentation, blank thickness m, window m of path,
    compliances (3,) m/N of both tools, flow stress Pa in plane strain and constraint factor of the indentation
    behind k_m; ``present`` False: there is no second tool."""

    present: bool
    forming_radius: float
    support_radius: float
    stiffness: float
    memory: float
    thickness: float
    window: float
    forming_compliance: Array
    support_compliance: Array
    flow_stress: float
    constraint: float


class Squeeze(NamedTuple):
    """State: force (3,) N on the support tool, indentation (1,) m, local sheet thickness (1,) m."""

    force: Array
    indentation: Array
    thickness: Array


def no_squeeze() -> Squeeze:
    """Tools apart."""
    return Squeeze(np.zeros(3), np.zeros(1), np.zeros(1))


def indentation_stiffness(forming_radius: float, support_radius: float, flow_stress: float, factor: float) -> float:
    """k_m, N/m: half of the footprint carries in the moving contact; ``factor`` = 2.8 (constraint)."""
    radius = 2.0 * forming_radius * support_radius / (forming_radius + support_radius)
    return 0.5 * math.pi * radius * factor * flow_stress


@kernel
def squeeze_sheet(
    forming_tip: Array, support_tip: Array, surface: Surface, contact: Contact, state: Squeeze, c: SqueezeConstants
) -> None:
    """Update ``state`` and the surface's squeeze memory for both servo tips (3,) m."""
    state.force[:] = 0.0
    state.indentation[0] = 0.0
    if not c.present:
        return
    d = np.empty(3)
    centre = np.empty(3)
    for k in range(3):
        # the tool gives way against the force it puts on the sheet
        centre[k] = forming_tip[k] - c.forming_compliance[k] * contact.force[k]
        d[k] = support_tip[k] - centre[k]
    centre[2] += c.forming_radius
    d[2] -= c.support_radius + c.forming_radius
    distance = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    reach = c.forming_radius + c.support_radius
    if distance - reach > c.thickness or distance < 1e-9:
        return
    give = 1.0 / c.stiffness
    for k in range(3):
        d[k] /= distance
        give += d[k] * d[k] * (c.forming_compliance[k] + c.support_compliance[k])
    x, y = centre[0] + c.forming_radius * d[0], centre[1] + c.forming_radius * d[1]
    state.thickness[0] = _local_thickness(x, y, surface, contact, c)
    overlap = state.thickness[0] - (distance - reach)
    if overlap <= 0.0:
        return
    force = overlap / give
    state.indentation[0] = force / c.stiffness
    for k in range(3):
        state.force[k] = force * d[k]
    _remember(x, y, force, surface, contact.path[TRAVELLED], c)


@kernel
def eased_tension(state: Squeeze, contact: Contact, c: SqueezeConstants) -> float:
    """N, tension that the sheet at the forming tool needs less to yield, because both tools squeeze it there.

    Between the balls the wall carries the membrane stress s_1 along its line of steepest slope and -p through its
    thickness; along the loop it does not strain. Tresca: s_1 + p = s_f, so a strip that is squeezed yields at s_f - p
    (s_f is the flow stress in plane strain). The force F_n is carried by a contact of radius a,
    F_n = pi a^2 constraint s_f, and spreads at 45 deg (assumed) to the middle of the sheet, over a circle of diameter
    w = 2 a + t: p = min(4 F_n / (pi w^2), s_f). Tension is the same all along a strip that runs round the ball without
    friction, so every strip through the circle is as weak as in it, and on the width w the tension is p t w less.

    Limits: t >> a gives 4 F_n / pi whatever the sheet, a >> t the whole strength s_f t w of the strip. The axial force
    falls by the part along the axis, sin(wall angle) times this (:func:`isf_sim.sheet.sheet_point.advance_point`). None
    when the squeezed circle lies altogether beyond the tip, away from the wall that ``contact`` holds.
    """
    force = math.sqrt(state.force[0] ** 2 + state.force[1] ** 2 + state.force[2] ** 2)
    if force <= 0.0:
        return 0.0
    t = state.thickness[0]
    width = 2.0 * math.sqrt(force / (math.pi * c.constraint * c.flow_stress)) + t
    pressure = min(4.0 * force / (math.pi * width * width), c.flow_stress)
    ahead = c.forming_radius * (state.force[0] * contact.wall[1] + state.force[1] * contact.wall[2]) / force
    return min(max(1.0 + 2.0 * ahead / width, 0.0), 1.0) * pressure * t * width


def lasting_indentation(surface: Surface, c: SqueezeConstants) -> Array:
    """(ny, nx) m, what the squeeze of all passes has left in the thickness, on the nodes of ``surface``."""
    return np.asarray(c.memory * surface.squeeze / c.stiffness)


@kernel
def _local_thickness(x: float, y: float, surface: Surface, contact: Contact, c: SqueezeConstants) -> float:
    """m: t0 cos(alpha) less the lasting indentation of earlier passes, at least SQUEEZED_THINNEST of the former."""
    slope = contact.wall[0]
    formed = c.thickness / math.sqrt(1.0 + slope * slope)
    return max(
        formed - c.memory * _earlier_force(x, y, surface, contact.path[TRAVELLED], c) / c.stiffness,
        SQUEEZED_THINNEST * formed,
    )


@kernel
def _earlier_force(x: float, y: float, surface: Surface, path: float, c: SqueezeConstants) -> float:
    """N, largest force of earlier passes at (x, y) m, linear between the nodes; clamped at the border."""
    i, j, a, b = corner_of(surface.squeeze, surface.x0, surface.y0, surface.h, x, y)
    force = 0.0
    for row in range(2):
        for column in range(2):
            recent = path - surface.squeezed[j + row, i + column] < c.window
            earlier = surface.squeeze_before if recent else surface.squeeze
            force += (b if row else 1.0 - b) * (a if column else 1.0 - a) * earlier[j + row, i + column]
    return force


@kernel
def _remember(x: float, y: float, force: float, surface: Surface, path: float, c: SqueezeConstants) -> None:
    """Only load above the largest earlier one thins further (shakedown)."""
    half = math.sqrt(c.forming_radius * force / c.stiffness + 1e-15)
    ny, nx = surface.height.shape
    i0, i1 = int((x - half - surface.x0) / surface.h), int((x + half - surface.x0) / surface.h) + 2
    j0, j1 = int((y - half - surface.y0) / surface.h), int((y + half - surface.y0) / surface.h) + 2
    for j in range(max(j0, 0), min(j1, ny)):
        for i in range(max(i0, 0), min(i1, nx)):
            if path - surface.squeezed[j, i] >= c.window:
                surface.squeeze_before[j, i] = surface.squeeze[j, i]
                surface.squeezed[j, i] = path
            surface.squeeze[j, i] = max(surface.squeeze[j, i], force)
