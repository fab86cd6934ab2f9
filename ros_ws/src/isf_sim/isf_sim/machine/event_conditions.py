"""Conditions that events begin and end with, found by the compiled tick.

To gather the facts of a tick in the interpreter and to look at them takes longer than the tick. Most ticks have the
conditions of the tick before, and a watch for which another look at these would change nothing need not look:
:func:`settled`. Where a bound is met so closely that compiled code and interpreter might not agree, and while anything
is counted, it looks (bit DOUBT, or no settling).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.events import EventKind

from isf_sim.jit import kernel
from isf_sim.machine.events import ENGAGED, ENGAGED_AFTER, LOADED, EventLimits, EventWatch
from isf_sim.machine.load_cells import CellState
from isf_sim.machine.tick import Axes
from isf_sim.sheet.sheet_point import Contact
from isf_sim.sheet.squeeze import Squeeze
from isf_sim.sheet.surface import Surface
from isf_sim.sheet.thickness import thinning_up_the_wall

TOUCHING = 1.0
"""N between sheet and support, from which on they touch."""
SLACK = 1.0e-9
"""m of gap, and strain, within which a bound counts as met in doubt."""

CHIPS, CARRIES, FREE, BESIDE, ON_SUPPORT, SATURATED, CLIPPED, THIN, LIMITED, DOUBT = (1 << k for k in range(10))
"""Bits: support force above the limit of chips, above ENGAGED, none at all; tools together and pressing; sheet on its
support; an axis saturates; a reading clipped; wall perhaps thinner than the limit without squeeze; bits of Axes.flags;
a bound met too closely to tell."""

NEVER = -1
"""Conditions that no tick has."""


class EventBounds(NamedTuple):
    """Limits of support force N and strain without squeeze, of the gap m; radii m of upper and lower ball (0: none);
    blank thickness m."""

    galling: float
    strain: float
    gap: float
    upper: float
    lower: float
    thickness: float


def event_bounds(limits: EventLimits, radii: tuple[float, float], blank: float) -> EventBounds:
    """Bounds for ``limits``, ``radii`` m of both balls (0: no second tool) and a ``blank`` m thick."""
    return EventBounds(limits.galling, limits.fracture, 3.0 * limits.thickness, *radii, blank)


@kernel
def conditions(
    turned: bool,
    radius: float,
    axes: Axes,
    surface: Surface,
    contact: Contact,
    squeeze: Squeeze,
    cell_1: CellState,
    cell_2: CellState,
    bounds: EventBounds,
) -> int:
    """Bits after a tick; ``turned``: the lower tool presses; ``radius`` m of the tool that presses."""
    bits = 0
    axial = -axes.force_2[2] if turned else axes.force_1[2]
    support = axes.force_1 if turned else axes.force_2
    fx, fy, fz = support[0], support[1], support[2]
    force = math.sqrt(fx * fx + fy * fy + fz * fz)
    if force > bounds.galling:
        bits |= CHIPS
    if force > ENGAGED:
        bits |= CARRIES
    if force <= 0.0:
        bits |= FREE
    if bounds.lower > 0.0:
        dx, dy = axes.tips[0, 0] - axes.tips[1, 0], axes.tips[0, 1] - axes.tips[1, 1]
        dz = axes.tips[1, 2] - bounds.lower - axes.tips[0, 2] - bounds.upper
        gap = math.sqrt(dx * dx + dy * dy + dz * dz) - bounds.upper - bounds.lower
        if gap < bounds.gap and axial > LOADED:
            bits |= BESIDE
        if abs(gap - bounds.gap) < SLACK:
            bits |= DOUBT
    if contact.on_die[0] > TOUCHING:
        bits |= ON_SUPPORT
    if axes.saturated[0] != 0:
        bits |= SATURATED
    if cell_1.clipped[0] > 0 or cell_2.clipped[0] > 0:
        bits |= CLIPPED
    if axes.flags[0] != 0:
        bits |= LIMITED
    if contact.axial[0] > 0.0:
        place = np.empty(3)
        tip = contact.formed_tip
        strain = thinning_up_the_wall(surface, tip[0], tip[1], contact.wall, radius, place)
        if fz != 0.0:  # as isf_sim.machine.simulated_machine tells it
            slope = contact.wall[0]
            formed = bounds.thickness / math.sqrt(1.0 + slope * slope)
            strain += max(math.log(formed / squeeze.thickness[0]), 0.0)
        if not strain < bounds.strain - SLACK:
            bits |= THIN
    return bits


def settled(watch: EventWatch, bits: int) -> bool:
    """True when ``watch``, which has looked at a tick with the conditions ``bits``, would find nothing at another one,
    and change nothing that counts."""
    if bits & (CLIPPED | LIMITED | DOUBT):
        return False
    if bits & THIN and not watch.broken:
        return False  # the way since it is thin is looked at
    if bits & CARRIES and watch.engaged < ENGAGED_AFTER:
        return False
    holds = {
        EventKind.GALLING: bool(bits & CHIPS),
        EventKind.CONTACT_LOST: watch.carrying and bool(bits & FREE),
        EventKind.DIE_CONTACT: bool(bits & ON_SUPPORT),
        EventKind.SATURATION: bool(bits & SATURATED),
    }
    # what holds and was told stays so; what neither holds nor was told long enough ago is not counted
    return all(seen.told == holds.get(EventKind[name], False) for name, seen in watch.occurrences.items())
