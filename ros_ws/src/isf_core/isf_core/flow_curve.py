"""Flow curve of a sheet material, Hollomon's law: flow stress = K strain^n.

Where the material file does not give K and n, they follow from yield and tensile strength: the tensile test becomes
unstable at the strain n (Considere), so the tensile strength is K (n / e)^n, and the yield strength is taken at the
plastic strain of 0.2 %. This is an estimate; the material file should give measured values where there are some.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from isf_core.material import Material

Array = NDArray[np.float64]

YIELD_STRAIN = 0.002
"""Plastic strain at which yield strength is defined."""

SMALLEST_EXPONENT = YIELD_STRAIN * np.e
"""Hardening exponent at which the estimate gives a tensile strength equal to the yield strength."""


@dataclass(frozen=True)
class FlowCurve:
    """Hollomon's law.

    Attributes
    ----------
    strength_coefficient : Pa, K ; exponent : n
    estimated : from yield and tensile strength, not from the material file
    """

    strength_coefficient: float
    exponent: float
    estimated: bool

    def stress(self, strain: Array | float) -> Array:
        """Pa, flow stress at the equivalent plastic ``strain`` (taken as 0.2 % at least)."""
        return np.asarray(self.strength_coefficient * np.maximum(strain, YIELD_STRAIN) ** self.exponent)


def flow_curve(material: Material) -> FlowCurve:
    """Flow curve of ``material``: its own constants, or estimated from yield and tensile strength."""
    if material.strength_coefficient is not None and material.hardening_exponent is not None:
        return FlowCurve(material.strength_coefficient, material.hardening_exponent, estimated=False)
    ratio = np.log(max(material.tensile_strength / material.yield_strength, 1.0))
    exponent = SMALLEST_EXPONENT
    if ratio > 0.0:
        exponent = float(brentq(lambda n: n * np.log(n / SMALLEST_EXPONENT) - ratio, SMALLEST_EXPONENT, 1.5))
    coefficient = material.tensile_strength * (np.e / exponent) ** exponent
    return FlowCurve(float(coefficient), exponent, estimated=True)


def plane_strain(initial: float, thickness: Array | float) -> Array:
    """Equivalent strain of a wall thinned from ``initial`` to ``thickness`` (m) in plane strain: 2/sqrt(3) ln(t0/t)."""
    return np.asarray(2.0 / np.sqrt(3.0) * np.log(np.maximum(initial / np.asarray(thickness), 1.0)))
