"""Which of the two tools forms: decided from contact alone, because nobody tells a machine.

The sheet between two tools goes where the pair holds it. When it is held below where it would lie unloaded, the upper
tool presses it and the lower one supports; when it is held above, the other way round. "Held" is the middle of the gap
between the balls. A planned support tool stands a little too close on the first contours of a part (the thickness of
the finished wall is assumed where the sheet is still thick), which speaks against the forming tool by up to
t0 / 2 - incremental depth, t0 / 2 at most: only stronger evidence changes the roles.

All heights are in the frame of the plant, turned over while the lower tool presses (:mod:`isf_sim.sheet.turned_sheet`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.sheet.contact_kernels import touching_tip
from isf_sim.sheet.sheet_point import TRAVELLED, Contact
from isf_sim.sheet.squeeze import SqueezeConstants
from isf_sim.sheet.surface import Surface, bilinear

NEEDS_TURN = 3
"""Asked for by the tick when the other tool presses now; see sheet_point.DONE."""
NOT_IN_DOUBT = -1.0


class Role(NamedTuple):
    """State: ``pressing`` (1,) 1 upper, 2 lower tool; ``free`` (1,) 1 when both tools have left the sheet;
    ``doubt`` (1,) m, path length since which the evidence is against the pressing tool, NOT_IN_DOUBT without."""

    pressing: NDArray[np.int64]
    free: NDArray[np.int64]
    doubt: Array


def first_role() -> Role:
    """The upper tool presses, until it is seen otherwise."""
    return Role(np.ones(1, dtype=np.int64), np.ones(1, dtype=np.int64), np.full(1, NOT_IN_DOUBT))


@kernel
def other_tool_presses(
    forming: Array,
    support: Array,
    step: float,
    surface: Surface,
    contact: Contact,
    role: Role,
    c: SqueezeConstants,
) -> bool:
    """True when the tool taken for the support presses; tips (3,) m in the plant's frame, ``step`` m per contour.

    Calling it again in the same tick gives the same answer, and False once the sheet is turned over.
    """
    touches = _depth(surface, forming[0], forming[1], forming[2], c.forming_radius, 1.0) > 0.0
    other = _depth(surface, support[0], support[1], -support[2] - c.thickness, c.support_radius, -1.0)
    if not touches and other <= 0.0:
        role.free[0] = 1
        role.doubt[0] = NOT_IN_DOUBT
        return False
    evidence = _evidence(forming, support, surface, c)
    beside = not math.isnan(evidence)
    if role.free[0] != 0:
        role.free[0] = 0
        if beside:
            return evidence > max(0.5 * c.thickness - step, 0.0)
        return not touches
    if not beside:
        role.doubt[0] = NOT_IN_DOUBT
        return not touches and other > 0.5 * c.thickness
    if evidence <= 0.5 * c.thickness:
        role.doubt[0] = NOT_IN_DOUBT
        return False
    path = contact.path[TRAVELLED]
    if role.doubt[0] < 0.0:
        role.doubt[0] = path
    return path - role.doubt[0] > c.forming_radius


@kernel
def _evidence(forming: Array, support: Array, surface: Surface, c: SqueezeConstants) -> float:
    """m by which the pair holds the sheet on the wrong side for the present roles, NaN for tools apart."""
    dx, dy = support[0] - forming[0], support[1] - forming[1]
    dz = (support[2] - c.support_radius) - (forming[2] + c.forming_radius)
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    gap = distance - c.forming_radius - c.support_radius
    if gap > c.thickness + c.forming_radius or distance < 1e-9:
        return math.nan
    share = (c.forming_radius + 0.5 * gap) / distance
    x, y = forming[0] + share * dx, forming[1] + share * dy
    held = forming[2] + c.forming_radius + share * dz
    return held - bilinear(surface.height, surface.x0, surface.y0, surface.h, x, y) + 0.5 * c.thickness


@kernel
def _depth(surface: Surface, x: float, y: float, tip: float, radius: float, side: float) -> float:
    """m by which a ball at (x, y) reaches into the unloaded sheet from above (``side`` 1) or, turned over, below (-1);
    ``tip`` m over the face that it meets; -inf when it is clear."""
    return touching_tip(surface, surface.height, side, x, y, radius) - tip
