"""Pump, valves and cylinders of six legs, compiled: from the commands of the valves to the motion of the rods.

One pump of constant flow with a relief valve feeds six proportional valves; each moves a piston whose sides differ by
the rod. Oil is compressible, so a leg is a spring between two oil columns; the platform couples the legs by its
inertia (:func:`isf_sim.legs.platform.seen_by_legs`). SI: Pa, m^3/s, m, s; a push of a leg extends it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.files.hydraulic_legs import HydraulicLegs
from isf_core.process import cylinder_speed
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel

STEP = 1.0e-4
"""s, largest step of the integration."""
LAMINAR = 1.0e5
"""Pa, pressure difference below which the flow through an edge turns laminar (assumed)."""
CREEP = 1.0e-3
"""m/s, speed over which friction builds up (assumed)."""
OVERRIDE = 5.0e5
"""Pa below its setting at which the relief valve opens; there it passes the whole flow of the pump (assumed)."""

LEAKAGE_PRESSURES = 210e5, 100e5
"""Pa, at which the leakage of valves and pistons is given."""

PRESSURE, TEMPERATURE = 0, 1
"""Of the supply's state."""


class Hydraulics(NamedTuple):
    """Constants; areas (2,) m^2 and volumes m^3 of the side of the piston, then of the rod.

    Attributes
    ----------
    pump_flow : m^3/s ; relief : Pa ; volume : m^3 of the lines ; bulk : Pa ; relief_gain : m^3/s/Pa
    rated : m^3/s through an edge of the piston's side at the full opening per root of Pa, ``rod_side`` through one of
        the rod's side ; dead_band : share of the opening
    pole, damping : rad/s and damping of the spool ; supply_leak, piston_leak : m^3/s/Pa ; vent : opening to the tank
    areas ; dead_volume ; stroke ; coulomb N ; viscous N s/m
    heat : W ; heat_loss : W/K ; heat_capacity : J/K ; ambient : K above 0 deg C
    """

    pump_flow: float
    relief: float
    volume: float
    bulk: float
    relief_gain: float
    rated: float
    rod_side: float
    dead_band: float
    pole: float
    damping: float
    supply_leak: float
    piston_leak: float
    vent: float
    areas: Array
    dead_volume: float
    stroke: float
    coulomb: float
    viscous: float
    heat: float
    heat_loss: float
    heat_capacity: float
    ambient: float


def hydraulics_of(legs: HydraulicLegs, stroke: float, *, speed: float = 1.0, damping: float = 1.0) -> Hydraulics:
    """Constants of ``legs`` with ``stroke`` m; ``speed`` and ``damping`` are factors of a variant on the valves."""
    valve, cylinder, supply = legs.valve, legs.cylinder, legs.supply
    return Hydraulics(
        pump_flow=supply.flow,
        relief=supply.pressure,
        volume=supply.line_volume,
        bulk=supply.bulk_modulus,
        relief_gain=supply.flow / OVERRIDE,
        rated=valve.flow / math.sqrt(valve.pressure_drop),
        rod_side=valve.edge_ratio * valve.flow / math.sqrt(valve.pressure_drop),
        dead_band=valve.dead_band,
        pole=2.0 * math.pi * valve.bandwidth * speed,
        damping=valve.damping * damping,
        supply_leak=6.0 * valve.leakage / LEAKAGE_PRESSURES[0],
        piston_leak=cylinder.leakage / LEAKAGE_PRESSURES[1],
        vent=valve.vent,
        areas=0.25 * math.pi * np.array([cylinder.bore**2, cylinder.bore**2 - cylinder.rod**2]),
        dead_volume=cylinder.dead_volume,
        stroke=stroke,
        coulomb=cylinder.friction,
        viscous=cylinder.viscous_friction,
        heat=supply.heating,
        heat_loss=supply.cooling if supply.cooler else 0.0,
        heat_capacity=supply.heat_capacity,
        ambient=supply.ambient,
    )


@kernel
def edge_flow(opening: float, drop: float, rated: float) -> float:
    """m^3/s through an edge of a valve opened by ``opening`` under the pressure ``drop`` Pa, of its sign."""
    return rated * opening * drop / math.sqrt(abs(drop) + LAMINAR)


@kernel
def opening_of(spool: float, dead_band: float) -> float:
    """Opening, -1 to 1, of a valve with its ``spool`` at -1 to 1: nothing within the dead band, linear beyond."""
    if abs(spool) <= dead_band:
        return 0.0
    share = (abs(spool) - dead_band) / (1.0 - dead_band)
    return share if spool > 0.0 else -share


@kernel
def oil_stiffness(stroke: float, c: Hydraulics) -> float:
    """N/m, of the two oil columns of a leg with its valve shut."""
    total = 0.0
    for side in range(2):
        length = stroke if side == 0 else c.stroke - stroke
        total += c.bulk * c.areas[side] ** 2 / (c.dead_volume + c.areas[side] * length)
    return total


@kernel
def step_oil(
    commands: Array,
    stuck: NDArray[np.bool_],
    pump: bool,
    power: bool,
    mobility: Array,
    free: Array,
    pull: Array,
    step: float,
    c: Hydraulics,
    spools: Array,
    pressures: Array,
    motion: Array,
    supply: Array,
) -> None:
    """One step of ``step`` s with the ``commands`` (6,), -1 to 1, of the valves.

    ``stuck`` (6,) bool, spools that do not move; without ``power`` the spools are shut and both sides of the pistons
    open to the tank. Updates ``spools`` (6, 2), ``pressures`` (6, 2) Pa, ``motion`` (6, 2) m and m/s, ``supply`` (2,).
    """
    drawn = supply[PRESSURE] * c.supply_leak
    force = np.empty(6)
    for k in range(6):
        if not stuck[k]:
            wanted = commands[k] if power else 0.0
            spools[k, 1] += step * (c.pole**2 * (wanted - spools[k, 0]) - 2.0 * c.damping * c.pole * spools[k, 1])
            spools[k, 0] += step * spools[k, 1]
            if abs(spools[k, 0]) >= 1.0:
                spools[k, 0] = min(max(spools[k, 0], -1.0), 1.0)
                spools[k, 1] = 0.0
        opening = opening_of(spools[k, 0], c.dead_band)
        a, b = pressures[k, 0], pressures[k, 1]
        if opening >= 0.0:
            into_a = edge_flow(opening, supply[PRESSURE] - a, c.rated)
            into_b = -edge_flow(opening, b, c.rod_side)
            drawn += into_a
        else:
            into_a = -edge_flow(-opening, a, c.rated)
            into_b = edge_flow(-opening, supply[PRESSURE] - b, c.rod_side)
            drawn += into_b
        if not power:
            into_a -= edge_flow(c.vent, a, c.rated)
            into_b -= edge_flow(c.vent, b, c.rod_side)
        through = c.piston_leak * (a - b)
        x, v = motion[k, 0], motion[k, 1]
        in_a = c.dead_volume + c.areas[0] * x
        in_b = c.dead_volume + c.areas[1] * (c.stroke - x)
        # the tank is at 0: a side that is pulled empty stays there
        pressures[k, 0] = max(a + step * c.bulk / in_a * (into_a - through - c.areas[0] * v), 0.0)
        pressures[k, 1] = max(b + step * c.bulk / in_b * (into_b + through + c.areas[1] * v), 0.0)
        push = pressures[k, 0] * c.areas[0] - pressures[k, 1] * c.areas[1]
        force[k] = push + pull[k] - c.viscous * v - c.coulomb * math.tanh(v / CREEP)
    for k in range(6):
        gain = free[k]
        for other in range(6):
            gain += mobility[k, other] * force[other]
        motion[k, 1] += step * gain
    for k in range(6):
        motion[k, 0] += step * motion[k, 1]
        if motion[k, 0] <= 0.0 or motion[k, 0] >= c.stroke:
            motion[k, 0] = min(max(motion[k, 0], 0.0), c.stroke)
            motion[k, 1] = 0.0
    relieved = max(supply[PRESSURE] - (c.relief - OVERRIDE), 0.0) * c.relief_gain
    delivered = c.pump_flow if pump else 0.0
    # a check valve keeps the oil from running back through the pump
    supply[PRESSURE] = max(supply[PRESSURE] + step * c.bulk / c.volume * (delivered - drawn - relieved), 0.0)


@kernel
def warm_oil(pump: bool, time: float, c: Hydraulics, supply: Array) -> None:
    """Temperature of the tank after ``time`` s, in deg C (Torrao 2013, eq. 3.15 and 3.16 as one heat balance)."""
    heat = c.heat if pump else 0.0
    supply[TEMPERATURE] += time * (heat - c.heat_loss * (supply[TEMPERATURE] - c.ambient)) / c.heat_capacity


@kernel
def balanced_pressures(push: float, c: Hydraulics, pressures: Array) -> None:
    """Write the pressures (2,) Pa of a leg at rest that pushes with ``push`` N, as slow motion leaves them."""
    pressures[1] = max(c.relief * c.areas[0] / (c.areas[0] + c.areas[1]), -push / c.areas[1])
    pressures[0] = (push + pressures[1] * c.areas[1]) / c.areas[0]


def free_speeds(c: Hydraulics) -> tuple[float, float]:
    """m/s, of an unloaded leg with its valve fully open outwards and inwards, at the relief pressure."""
    return cylinder_speed.free_speeds((c.areas[0], c.areas[1]), (c.rated, c.rod_side), c.relief)
