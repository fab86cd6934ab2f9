"""One tool position on the sheet: contact, force, envelope and tip track (the plant's kernel)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.types import Array

from isf_sim.jit import kernel
from isf_sim.sheet.contact_kernels import axial_force, envelope, probe_wall, support_height, touch_heights
from isf_sim.sheet.control_points import APPROACH, BEGIN, NOTHING, ControlPoints, blend, coarse_request
from isf_sim.sheet.surface import LONG_AGO, Surface, TipTrack

DONE, NEEDS_SOLUTION, NEEDS_BASE, NEEDS_RESULT = 0, 1, 2, 4
"""What :func:`advance_point` asks for; nothing has changed unless it returns DONE."""

TRAVELLED, LAST_BASE, LOOP, PRESSED = 0, 1, 2, 3
"""Places in Contact.path."""

SMALLEST_LOOP_RADII = 10.0
"""Path, in tool radii, after which a second visit of a place is a new loop."""


MINIMUM_AMPLITUDE = 1.0
"""N, what is left of the force of a plastic step at least, however hard the sheet is squeezed."""


class PointConstants(NamedTuple):
    """What the kernel needs of sheet, tool and rig, SI.

    Attributes
    ----------
    radius : forming tool ; amplitude : N, force regression without angle and scallop ; step : reference step
    friction, tangential_share, exponent, wrap_exponent : see PlantConstants
    compliance : (3,) m/N, tool with its axes ; local_compliance : m/N, sheet below the coarse grid's scale
    die_stiffness : N/m, indentation of the sheet between tool and support
    window, lag_length, fresh_depth, fresh_distance : m
    """

    radius: float
    amplitude: float
    step: float
    friction: float
    tangential_share: float
    exponent: float
    wrap_exponent: float
    compliance: Array
    local_compliance: float
    die_stiffness: float
    window: float
    lag_length: float
    fresh_depth: float
    fresh_distance: float


class Contact(NamedTuple):
    """State of the contact of the forming tool, mutable arrays.

    Attributes
    ----------
    path : (4,) m, way travelled, way at the last base update, length of the last loop, way travelled in contact
    last : (3,) m, last tip ; lateral : (2,) N, lagged horizontal force on the sheet ; drift : (2,) m, lagged
        horizontal motion of the sheet
    force : (3,) N, force on the sheet and a support below it (z negative: pressed down), zero without contact
    axial : (1,) N, axial force that the sheet carries ; on_die : (1,) N, squeezed through it against a support
    sag : (1,) m, deflection of the sheet at the tool, positive down
    eased : (1,) N, tension that squeezed sheet needs less to yield, lagged
    wall : (4,) steepest slope, unit vector towards the wall (2), wrap
    formed_tip : (3,) m, tip in the coordinates of the unloaded sheet
    """

    path: Array
    last: Array
    lateral: Array
    drift: Array
    force: Array
    axial: Array
    on_die: Array
    sag: Array
    wall: Array
    formed_tip: Array
    eased: Array


def no_contact(tip: Array) -> Contact:
    """A tool clear of the sheet at ``tip`` (3,) m."""
    return Contact(
        path=np.zeros(4),
        last=tip.copy(),
        lateral=np.zeros(2),
        drift=np.zeros(2),
        force=np.zeros(3),
        axial=np.zeros(1),
        on_die=np.zeros(1),
        sag=np.zeros(1),
        wall=np.zeros(4),
        formed_tip=tip.copy(),
        eased=np.zeros(1),
    )


@kernel
def advance_point(
    tip: Array,
    pull: Array,
    eased: float,
    surface: Surface,
    track: TipTrack,
    points: ControlPoints,
    contact: Contact,
    constants: PointConstants,
) -> int:
    """Move the forming tool to ``tip`` (3,) m under the horizontal ``pull`` (2,) N of the support tool on it.

    Equilibrium along z (plastic and elastic branch, the smaller force counts, so lifting is reversible):
    H - z = (c_z + c_loc) F + S(F) + step (F/A)^(1/m); horizontally x_eff = x - C f + C pull - u with lagged f, u.
    A is less by the axial part of ``eased`` N, tension that squeezed sheet does not need to yield: lagged as f is,
    because sheet that is not squeezed has to leave the tool first. A tool that reaches down to a die has none of it.
    """
    x, y, z = tip[0], tip[1], tip[2]
    dx, dy, dz = x - contact.last[0], y - contact.last[1], z - contact.last[2]
    way = math.sqrt(dx * dx + dy * dy + dz * dz)
    path = contact.path[TRAVELLED] + way
    radius = constants.radius
    xe = x - constants.compliance[0] * (contact.lateral[0] - pull[0]) - contact.drift[0]
    ye = y - constants.compliance[1] * (contact.lateral[1] - pull[1]) - contact.drift[1]
    touch = np.empty(2)
    touch_heights(surface, path, constants.window, xe, ye, radius, touch)
    in_contact = touch[0] > z
    if touch[0] > z - APPROACH:
        request = coarse_request(points, x, y, min(z, touch[0]), path, constants.fresh_depth, constants.fresh_distance)
        if request != NOTHING:
            return NEEDS_SOLUTION if request == BEGIN else NEEDS_RESULT
    if in_contact:
        loop = contact.path[LOOP]
        # way travelled so far, without this step: the update marks it as done, however long the step is
        due = max(loop / 16.0, 0.8 * radius) if loop > 0.0 else 6.0 * radius
        if contact.path[TRAVELLED] - contact.path[LAST_BASE] > due:
            return NEEDS_BASE
    contact.path[TRAVELLED] = path
    contact.last[0], contact.last[1], contact.last[2] = x, y, z
    blending = min(way / constants.lag_length, 1.0)
    contact.formed_tip[0], contact.formed_tip[1], contact.formed_tip[2] = xe, ye, z
    contact.force[:] = 0.0
    contact.on_die[0] = 0.0
    contact.sag[0] = 0.0
    contact.wall[:] = 0.0
    axial = 0.0
    if in_contact:
        contact.eased[0] += blending * (eased - contact.eased[0])
        axial = _press(xe, ye, z, dx, dy, way, touch, blending, surface, points, contact, constants)
    contact.axial[0] = axial
    if axial + contact.on_die[0] > 0.0:
        envelope(surface, path, constants.window, xe, ye, contact.formed_tip[2], radius)
        contact.path[PRESSED] += way
        _mark_track(track, contact, radius)
    else:
        contact.lateral[:] *= 1.0 - blending
        contact.drift[:] *= 1.0 - blending
        contact.eased[:] *= 1.0 - blending
    return DONE


@kernel
def _press(
    xe: float,
    ye: float,
    z: float,
    dx: float,
    dy: float,
    way: float,
    touch: Array,
    blending: float,
    surface: Surface,
    points: ControlPoints,
    contact: Contact,
    constants: PointConstants,
) -> float:
    """Equilibrium of the tool in contact; returns the axial force on the sheet, N."""
    radius, step = constants.radius, min(constants.step, constants.radius)
    wall = contact.wall
    probe_wall(surface, xe, ye, radius, wall)
    guess = max(contact.axial[0], 20.0)
    shift = np.empty(3)
    length = 0.7 * constants.fresh_distance
    exponent = blend(points, contact.last[0], contact.last[1], guess, length, shift)
    own = constants.compliance[2]
    compliance = own + constants.local_compliance
    # the support stands still in the room: neither sag nor drift of the sheet moves it
    die = support_height(surface, xe + contact.drift[0], ye + contact.drift[1], radius) - z
    amplitude = _amplitude(wall, step, contact.eased[0] if die <= 0.0 else 0.0, constants)
    sink = max(-shift[2], 0.0)
    m = constants.exponent
    plastic = axial_force(touch[0] - z, amplitude, m, step, compliance, guess, sink, exponent, own, die)
    elastic = axial_force(touch[1] - z, amplitude, m, 0.0, compliance, guess, sink, exponent, own, die)
    axial = min(plastic, elastic)
    stiffness = constants.die_stiffness
    squeezed = stiffness * max(die - own * axial, 0.0) / (1.0 + stiffness * own)
    contact.on_die[0] = squeezed
    if axial + squeezed <= 0.0:
        return 0.0
    scale = (axial / guess) ** exponent
    contact.sag[0] = sink * scale
    formed = z + max(own * axial, die) + constants.local_compliance * axial + contact.sag[0]
    contact.formed_tip[2] = formed
    groove = math.acos(max(1.0 - max(touch[0] - formed, 0.0) / radius, -1.0))
    radial = axial * math.tan(max(0.5 * (math.atan(wall[0]) - groove), 0.0))
    tangential = axial * (constants.friction + constants.tangential_share * groove) / way if way > 1e-12 else 0.0
    contact.lateral[0] += blending * (radial * wall[1] + tangential * dx - contact.lateral[0])
    contact.lateral[1] += blending * (radial * wall[2] + tangential * dy - contact.lateral[1])
    contact.drift[0] += blending * (shift[0] * scale - contact.drift[0])
    contact.drift[1] += blending * (shift[1] * scale - contact.drift[1])
    contact.force[0], contact.force[1] = contact.lateral[0], contact.lateral[1]
    contact.force[2] = -axial - squeezed
    return axial


@kernel
def _amplitude(wall: Array, step: float, eased: float, constants: PointConstants) -> float:
    """N, axial force of a plastic step ``step`` (Aerens et al. 2009, with measured wall and wrap), less what squeezed
    sheet needs less: ``eased`` N along the wall."""
    groove = math.acos(1.0 - step / constants.radius)
    angle = max(math.atan(wall[0]), groove)
    scallop = step * step / (8.0 * constants.radius * math.sin(angle) ** 2)
    amplitude = (
        constants.amplitude
        * (scallop * 1e3) ** (0.5 * constants.exponent)
        * math.degrees(angle)
        * math.cos(angle)
        * max(wall[3], 0.8) ** constants.wrap_exponent
    )
    if eased <= 0.0:
        return amplitude
    return max(amplitude - eased * math.sin(angle), min(amplitude, MINIMUM_AMPLITUDE))


@kernel
def _mark_track(track: TipTrack, contact: Contact, radius: float) -> None:
    """Note the tip on the track grid; a place met again after a while tells the length of the loop.

    Only way in contact counts: a tool that was lifted meanwhile goes on with the loop that it has left.
    """
    path = contact.path[PRESSED]
    i = round((contact.formed_tip[0] - track.x0) / track.h)
    j = round((contact.formed_tip[1] - track.y0) / track.h)
    ny, nx = track.tip.shape
    if 0 <= i < nx and 0 <= j < ny:
        since = path - track.visited[j, i]
        if track.visited[j, i] > 0.5 * LONG_AGO and since > SMALLEST_LOOP_RADII * radius:
            contact.path[LOOP] = since
        track.tip[j, i] = contact.formed_tip[2]
        track.visited[j, i] = path
