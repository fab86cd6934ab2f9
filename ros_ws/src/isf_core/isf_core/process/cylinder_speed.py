"""How fast a valve lets an unloaded hydraulic cylinder go."""

from __future__ import annotations

import math


def free_speeds(areas: tuple[float, float], flows: tuple[float, float], pressure: float) -> tuple[float, float]:
    """m/s, of an unloaded cylinder with its valve fully open outwards and inwards.

    From the flow through both edges and the balance of the piston: with areas A of the piston and a = r A of the rod's
    side, coefficients q and e q of their edges, outwards A v = q sqrt(p / (1 + r^3 / e^2)), inwards sqrt(r) of that.

    Parameters
    ----------
    areas : m^2, of piston and rod's side ; flows : m^3/s per root of Pa, through their edges ; pressure : Pa, supply
    """
    ratio = areas[1] / areas[0]
    out = flows[0] / areas[0] * math.sqrt(pressure / (1.0 + ratio**3 * (flows[0] / flows[1]) ** 2))
    return out, out * math.sqrt(ratio)
