"""Where a support force other than the job's holds: by wall, wall angle, corner, depth or place.

The published test of a pyramid asks for 100 to 200 N, different on adjacent walls (Ren 2018, 2.4). What a rule asks for
stands in the contours as their set-points, point by point; force control follows it at its own rate, so a rule that
begins in the middle of a wall needs no ramp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from isf_core.model_base import FileModel
from isf_core.quantity import Angle, Force, Length

Array = NDArray[np.float64]

RuleForce = Annotated[Force, Field(gt=0.0, le=1500.0)]


class ForceRule(FileModel):
    """One rule; it holds where all of its conditions hold, ends of a range included."""

    force: RuleForce
    """Set-point of the horizontal normal force there."""
    facing: tuple[Angle, Angle] | None = None
    """Direction of the outward normal in the plane, from x towards y, counter-clockwise from one to the other."""
    wall_angle: tuple[Angle, Angle] | None = None
    """Angle of the wall from the horizontal."""
    corner_radius: tuple[Length, Length] | None = None
    """Radius of the forming tool's path in the plane, not of the part; straight lines are in no range."""
    depth: tuple[Length, Length] | None = None
    """Of the forming tip below (or, formed from below, above) the blank."""
    x: tuple[Length, Length] | None = None
    """Of the forming tip."""
    y: tuple[Length, Length] | None = None
    """Of the forming tip."""

    @model_validator(mode="after")
    def _says_where(self) -> ForceRule:
        ranges = {name: getattr(self, name) for name in ("wall_angle", "corner_radius", "depth", "x", "y")}
        if self.facing is None and not any(ranges.values()):
            raise ValueError("the rule says nowhere: give facing, wall_angle, corner_radius, depth, x or y")
        for name, limits in ranges.items():
            if limits is not None and not limits[0] < limits[1]:
                raise ValueError(f"{name} must go from a smaller to a larger value")
            if limits is not None and name in ("wall_angle", "corner_radius", "depth") and limits[0] < 0.0:
                raise ValueError(f"{name} is never negative: begin at 0")
        turn = 2.0 * math.pi + 1e-9
        for name in ("facing", "wall_angle"):
            limits = getattr(self, name)
            if limits is not None and max(abs(limits[0]), abs(limits[1])) > turn:
                raise ValueError(f"{name} must lie within -360 and 360 deg")
        if self.facing is not None:
            begin, end = self.facing
            if math.isclose(begin, end, abs_tol=1e-9):
                raise ValueError("facing begins where it ends: give a range, or leave it out for all directions")
        return self


@dataclass(frozen=True)
class WallFacts:
    """What rules ask about the N points of a contour.

    Attributes
    ----------
    facing : (N,) rad, direction of the horizontal outward normal ; wall_angle : (N,) rad ; corner_radius : (N,) m,
        infinite on straight lines ; depth : (N,) m ; x, y : (N,) m
    """

    facing: Array
    wall_angle: Array
    corner_radius: Array
    depth: Array
    x: Array
    y: Array


def ruled_forces(rules: Sequence[ForceRule], force: float, facts: WallFacts) -> Array:
    """(N,) N: ``force``, and where a rule holds the rule's; of several the last one."""
    wanted = np.full(len(facts.facing), force)
    for rule in rules:
        wanted[holds(rule, facts)] = rule.force
    return wanted


def holds(rule: ForceRule, facts: WallFacts) -> NDArray[np.bool_]:
    """(N,) where all conditions of ``rule`` hold."""
    where = np.ones(len(facts.facing), dtype=bool)
    if rule.facing is not None:
        begin, end = rule.facing
        turn = 2.0 * math.pi
        span = (end - begin) % turn or turn  # from -180 to 180 deg is all round; equal ends are refused
        where &= np.mod(facts.facing - begin, turn) <= span
    for name in ("wall_angle", "corner_radius", "depth", "x", "y"):
        limits = getattr(rule, name)
        if limits is not None:
            value = getattr(facts, name)
            where &= (value >= limits[0]) & (value <= limits[1])
    return where
