"""Flow curves of sheet materials: Hollomon's, Swift's and Voce's law, and a table of points.

All give the flow stress, Pa, at an equivalent plastic strain. The first one has no yield point of its own: it holds
from the strain at which the yield strength is defined on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from isf_core.types import Array

YIELD_STRAIN = 0.002
"""Plastic strain at which yield strength is defined."""


class HardeningLaw(Protocol):
    """A flow curve.

    Attributes
    ----------
    begin : plastic strain from which on the law holds ; estimated : from yield and tensile strength, not from a file
    """

    @property
    def begin(self) -> float: ...

    @property
    def estimated(self) -> bool: ...

    def stress(self, strain: Array | float) -> Array:
        """Pa, flow stress at the equivalent plastic ``strain``, taken as ``begin`` at least."""


@dataclass(frozen=True)
class FlowCurve:
    """Hollomon's law (1945): K strain^n.

    Attributes
    ----------
    strength_coefficient : Pa, K ; exponent : n
    estimated : from yield and tensile strength, not from the material file
    """

    strength_coefficient: float
    exponent: float
    estimated: bool
    begin: ClassVar[float] = YIELD_STRAIN

    def stress(self, strain: Array | float) -> Array:
        """Pa, flow stress at the equivalent plastic ``strain`` (taken as 0.2 % at least)."""
        return np.asarray(self.strength_coefficient * np.maximum(strain, YIELD_STRAIN) ** self.exponent)


@dataclass(frozen=True)
class Swift:
    """Swift's law (1952): K (pre_strain + strain)^n, K in Pa."""

    strength_coefficient: float
    exponent: float
    pre_strain: float
    begin: ClassVar[float] = 0.0
    estimated: ClassVar[bool] = False

    def stress(self, strain: Array | float) -> Array:
        """Pa, flow stress at the equivalent plastic ``strain``."""
        return np.asarray(self.strength_coefficient * (self.pre_strain + np.maximum(strain, 0.0)) ** self.exponent)


@dataclass(frozen=True)
class Voce:
    """Voce's law (1948): saturation - (saturation - yield) exp(-strain / saturation_strain), stresses in Pa."""

    yield_stress: float
    saturation_stress: float
    saturation_strain: float
    begin: ClassVar[float] = 0.0
    estimated: ClassVar[bool] = False

    def stress(self, strain: Array | float) -> Array:
        """Pa, flow stress at the equivalent plastic ``strain``."""
        left = np.exp(-np.maximum(strain, 0.0) / self.saturation_strain)
        return np.asarray(self.saturation_stress - (self.saturation_stress - self.yield_stress) * left)


@dataclass(frozen=True)
class Tabulated:
    """Rows of plastic strain and stress (Pa), linear between them, constant after the last."""

    rows: tuple[tuple[float, float], ...]
    begin: ClassVar[float] = 0.0
    estimated: ClassVar[bool] = False

    def stress(self, strain: Array | float) -> Array:
        """Pa, flow stress at the equivalent plastic ``strain``."""
        table = np.array(self.rows)
        return np.asarray(np.interp(strain, table[:, 0], table[:, 1]))
