"""Target-force model: how hard a support tool should press, from sheet, tools, rig and wall angle.

The set-point is a horizontal normal force F_n. Three limits make a window:

keeping  K_c * 0.15 mm * t0 / 1 mm. An unforeseen gap that is wider than the elastic give of tools and sheet opens the
         contact before the loop has answered. Under position control contact is kept where the thickness is off by
         less than 50 um and lost from 150 um on (Moser 2016, cited in Praveen 2020); the larger one is taken, as a
         share of the thickness (assumed: the published sheets are about 1 mm)
chips    0.42 R_m R t0 sin(wall angle): the normal force F_n / sin(wall angle) from which the sheet sheds chips. The
         factor is calibrated between the 120 N that leave AA1100-O of 1 mm fine under tools of 4.5 mm on a wall of
         65 deg and the 200 N that shed chips (Ren 2018, 2.4.1); that it grows with R_m R t0 is assumed (depth of a
         plastic indentation over the thickness)
reach    half of the rig's offset limit times K_c: the other half is left for what the gap is off (assumed share)

The set-point is the geometric mean of the lowest and the highest force, in whole newtons.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

LOSING_GAP = 0.15
"""Thickness error over thickness at which an uncontrolled contact is lost: 150 um of 1 mm."""

CHIP_FACTOR = 0.42
"""Calibrated on Ren 2018, 2.4.1: total normal forces of 132 and 221 N, at their geometric mean."""

REACH_SHARE = 0.5
"""Share of the rig's offset limit that the set-point itself may take."""


def chip_force(tensile_strength: float, radius: float, thickness: float) -> float:
    """N, normal force from which chips are to be expected; Pa, m of the smaller tool, m of the blank."""
    return CHIP_FACTOR * tensile_strength * radius * thickness


@dataclass(frozen=True)
class SupportWindow:
    """Limits of the support force on one sheet, N.

    Attributes
    ----------
    keeping : least horizontal force that keeps contact
    chips : largest normal force (along the sheet's normal) without chips
    reach : largest horizontal force that the offset limit has room for
    """

    keeping: float
    chips: float
    reach: float

    def chips_at(self, wall_angle: Array) -> Array:
        """(N,) N, horizontal force from which chips are to be expected on walls of ``wall_angle`` (N,) rad."""
        return np.asarray(self.chips * np.sin(wall_angle))

    def highest(self, wall_angle: float) -> float:
        """N, largest horizontal force on a wall of ``wall_angle`` rad."""
        return min(float(self.chips_at(np.array(wall_angle))), self.reach)

    def set_point(self, wall_angle: float) -> float:
        """N, horizontal force for a wall of ``wall_angle`` rad; 0 where the window is empty."""
        highest = self.highest(wall_angle)
        return float(round(math.sqrt(self.keeping * highest))) if highest > self.keeping else 0.0

    @property
    def least_wall_angle(self) -> float:
        """rad, walls flatter than this have an empty window; pi/2 when all have."""
        if self.reach <= self.keeping or self.chips <= self.keeping:
            return 0.5 * math.pi
        return math.asin(self.keeping / self.chips)

    def explanation(self, wall_angle: float) -> str:
        """The set-point on a wall of ``wall_angle`` rad and why, one line for people."""
        force, highest = self.set_point(wall_angle), self.highest(wall_angle)
        bound = "sheds chips" if highest < self.reach else "uses half of the rig's offset limit"
        chosen = f"{force:.0f} N" if force > 0.0 else "position control"
        return (
            f"{chosen} on walls of {math.degrees(wall_angle):.0f} deg: contact is kept from {self.keeping:.0f} N on, "
            f"{highest:.0f} N {bound}"
        )


def support_window(
    tensile_strength: float, radius: float, thickness: float, contact_stiffness: float, offset_limit: float
) -> SupportWindow:
    """Window of a sheet (Pa, m) between tools of which the smaller has ``radius`` m, on a rig (N/m, m)."""
    return SupportWindow(
        keeping=contact_stiffness * LOSING_GAP * thickness,
        chips=chip_force(tensile_strength, radius, thickness),
        reach=REACH_SHARE * offset_limit * contact_stiffness,
    )


def check_window(window: SupportWindow, steepest: float, material: str) -> None:
    """Raise IsfError SUPPORT_FORCE_WINDOW when no wall up to ``steepest`` rad has a force that serves."""
    if window.set_point(steepest) > 0.0:
        return
    chips = float(window.chips_at(np.array(steepest)))
    raise IsfError(
        ErrorCode.SUPPORT_FORCE_WINDOW,
        f"{material} sheds chips from {chips:.0f} N on, the rig's offset limit has room "
        f"for {window.reach:.0f} N, and contact is kept from {window.keeping:.0f} N on: no force is suitable",
        where="control.support_force",
        advice="use tools of larger radius or a softer rig, give a force, or 0 N for position control",
    )
