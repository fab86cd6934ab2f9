"""Bending of a tool as a stepped cantilever with the load at its tip (Praveen 2020 eq. 4, for any number of steps)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def cantilever_compliance(steps: Sequence[tuple[float, float]], young_modulus: float) -> float:
    """m/N at the tip.

    Parameters
    ----------
    steps : (length m, diameter m) from the tip to the chuck
    young_modulus : Pa

    Raises
    ------
    ValueError : a length below 0, a diameter of 0 or less, or no step of any length
    """
    if not steps or min(length for length, _ in steps) < 0.0 or min(diameter for _, diameter in steps) <= 0.0:
        raise ValueError("every step of the tool needs a length of 0 or more and a positive diameter")
    if sum(length for length, _ in steps) <= 0.0:
        raise ValueError("the tool has no length")
    compliance, arm = 0.0, 0.0
    for length, diameter in steps:
        # each step bends under the moment F x: integral of x^2 / (E I) from its near to its far end
        inertia = np.pi * diameter**4 / 64.0
        compliance += ((arm + length) ** 3 - arm**3) / (3.0 * young_modulus * inertia)
        arm += length
    return float(compliance)
