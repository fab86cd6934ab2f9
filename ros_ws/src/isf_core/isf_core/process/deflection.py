"""Deflection under the forming force: of a clamped sheet under a ring load, and of a tool.

The sheet between clamp and opening is taken as a flat circular plate clamped at the radius ``r_b`` with a concentric
line load ``q`` (N/m) at the radius ``eta`` of the opening. The load needed for a deflection ``w`` at the ring is the
sum of linear plate theory and of a membrane without radial displacement, q = a w^3 + b w (Praveen 2020, eq. 5-16).
Published validity: eta / r_b from 0.84 to 0.9, one aluminium of 0.8 mm; elsewhere it is an extrapolation.

The tool is a stepped cantilever with the load at its tip (Praveen 2020 eq. 4, for any number of steps).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from isf_core.types import Array


@dataclass(frozen=True)
class SheetSection:
    """Elastic section of the blank, E Pa, nu and the *initial* thickness m (Praveen 2020, 2.3)."""

    young_modulus: float
    poisson_ratio: float
    thickness: float

    @property
    def bending_rigidity(self) -> float:
        """N m, D = E t^3 / (12 (1 - nu^2))."""
        return self.young_modulus * self.thickness**3 / (12.0 * (1.0 - self.poisson_ratio**2))

    @property
    def in_plane_rigidity(self) -> float:
        """N/m, C = E t / (1 - nu^2)."""
        return self.young_modulus * self.thickness / (1.0 - self.poisson_ratio**2)


@dataclass(frozen=True)
class LoadDeflectionLaw:
    """Coefficients of q = cubic w^3 + linear w; arrays of one shape, N/m^4 and N/m^2."""

    cubic: Array
    linear: Array


def ring_load_law(section: SheetSection, clamp_radius: ArrayLike, ring_radius: ArrayLike) -> LoadDeflectionLaw:
    """Coefficients for a ring of radius ``ring_radius`` in a clamp of radius ``clamp_radius`` (m).

    Praveen 2020 eq. 6 (bending, the ring-loaded clamped plate) and eq. 14 (membrane).

    Raises
    ------
    ValueError : not 0 < ring_radius < clamp_radius
    """
    outer, ring = np.broadcast_arrays(np.asarray(clamp_radius, float), np.asarray(ring_radius, float))
    if not (np.all(ring > 0.0) and np.all(ring < outer)):
        raise ValueError("the ring must lie inside the clamp: 0 < ring_radius < clamp_radius")
    plate = 2.0 * ring**2 * np.log(ring / outer) + 0.5 * (outer**2 - ring**2) * (1.0 + (ring / outer) ** 2)
    linear = 4.0 * section.bending_rigidity / (ring * plate)
    span = outer ** (2.0 / 3.0) - ring ** (2.0 / 3.0)
    cubic = 8.0 * section.in_plane_rigidity / (54.0 * ring * span**3)
    return LoadDeflectionLaw(np.asarray(cubic), np.asarray(linear))


def deflection(law: LoadDeflectionLaw, load: ArrayLike) -> Array:
    """m, the one real root of cubic w^3 + linear w = ``load`` (N/m).

    Closed form in hyperbolic functions: the same root as Cardano's (Praveen 2020, 2.4), without its
    cancellation where bending dominates.
    """
    scale = np.sqrt(law.linear / (3.0 * law.cubic))
    argument = np.asarray(load, dtype=float) / (2.0 * law.cubic * scale**3)
    return np.asarray(2.0 * scale * np.sinh(np.arcsinh(argument) / 3.0))


def ring_deflection(section: SheetSection, clamp_radius: ArrayLike, ring_radius: ArrayLike, load: ArrayLike) -> Array:
    """m, deflection of a ring under the line load ``load`` N/m; arguments and error as :func:`ring_load_law`."""
    return deflection(ring_load_law(section, clamp_radius, ring_radius), load)


def membrane_share(law: LoadDeflectionLaw, deflection: ArrayLike) -> Array:
    """Part of the load carried by membrane forces at ``deflection`` (m), 0..1."""
    w2 = np.asarray(deflection, dtype=float) ** 2
    return np.asarray(law.cubic * w2 / (law.cubic * w2 + law.linear))


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
