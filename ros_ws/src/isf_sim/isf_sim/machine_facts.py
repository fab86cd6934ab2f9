"""The facts of a tick that events are found in, read from the state of axes, contact and squeeze."""

from __future__ import annotations

import math

import numpy as np

from isf_sim.event_conditions import TOUCHING
from isf_sim.machine_event import TickFacts
from isf_sim.machine_tick import Axes
from isf_sim.sheet_plant import SheetPlant
from isf_sim.sheet_point import TRAVELLED
from isf_sim.squeeze import Squeeze
from isf_sim.thickness import thinning_up_the_wall


def tick_facts(
    tick: int,
    axes: Axes,
    plant: SheetPlant,
    squeeze: Squeeze,
    radii: tuple[float, float],
    *,
    buckles: float,
    clipped: int,
) -> TickFacts:
    """Facts after tick number ``tick``; ``radii`` m of both balls (0: no second tool)."""
    contact = plant.contact
    upper, lower = axes.tips.tolist()
    turned = plant.pressing == 2
    forming, support = (lower, upper) if turned else (upper, lower)
    on_forming, on_support = (axes.force_2, axes.force_1) if turned else (axes.force_1, axes.force_2)
    fx, fy, fz = on_support.tolist()
    gap = math.inf
    if radii[1] > 0.0:
        apart = math.dist(upper[:2], lower[:2])
        gap = math.hypot(apart, lower[2] - radii[1] - upper[2] - radii[0]) - radii[0] - radii[1]
    strain, place = 0.0, np.zeros(3)
    if contact.axial[0] > 0.0:
        tip = contact.formed_tip
        strain = float(thinning_up_the_wall(plant.surface, tip[0], tip[1], contact.wall, plant.radius, place))
        if fz != 0.0:  # what the support tool has squeezed thin comes on top
            slope = float(contact.wall[0])
            formed = plant.thickness / math.sqrt(1.0 + slope * slope)
            strain += max(math.log(formed / float(squeeze.thickness[0])), 0.0)
    return TickFacts(
        tick=tick,
        forming=tuple(forming),
        support=tuple(support),
        axial=-float(on_forming[2]) if turned else float(on_forming[2]),
        support_force=math.sqrt(fx * fx + fy * fy + fz * fz),
        gap=gap,
        strain=strain,
        thinnest=(float(place[0]), float(place[1]), -float(place[2]) if turned else float(place[2])),
        travelled=float(contact.path[TRAVELLED]),
        buckles=buckles,
        on_support=bool(contact.on_die[0] > TOUCHING),
        clipped=clipped,
        saturated=bool(axes.saturated[0]),
    )
