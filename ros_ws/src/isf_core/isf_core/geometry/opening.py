"""The opening of a part and the clamp around it, as radii seen from the middle of the opening.

The deflection model knows a circular opening in a circular clamp. Other shapes use the radius of the opening in
the direction of each point (Praveen 2020, 2.3: the deflection of a free-form opening varies along it).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from isf_core.types import Array

ClampRadius = Literal["equivalent", "local"]

SMALLEST_GAP = 0.04
"""Smallest distance of opening and clamp as part of the clamp radius: keeps the thin-annulus law defined where the
circle of equal area cuts the corners of an opening."""

_DIRECTIONS = 360


@dataclass(frozen=True)
class Opening:
    """Outermost loop of a feature.

    Attributes
    ----------
    centre : (2,) m, middle of its extent in x and y
    radius : (360,) m, distance of the loop from the centre, direction k at 2 pi k / 360 rad
    """

    centre: Array
    radius: Array

    @staticmethod
    def of(loop: Array) -> Opening:
        """Opening bounded by ``loop`` (N, 2) m; of several branches in one direction the last one counts."""
        centre = 0.5 * (loop.min(axis=0) + loop.max(axis=0))
        offset = loop - centre
        angle = np.arctan2(offset[:, 1], offset[:, 0])
        directions = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        radius = np.interp(directions, angle, np.linalg.norm(offset, axis=1), period=2.0 * np.pi)
        return Opening(centre, radius)

    def radius_towards(self, points: Array) -> Array:
        """(M,) m, radius of the opening in the direction of ``points`` (M, 2) m."""
        offset = points - self.centre
        angle = np.arctan2(offset[:, 1], offset[:, 0])
        directions = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        return np.asarray(np.interp(angle, directions, self.radius, period=2.0 * np.pi))

    def place_towards(self, points: Array) -> Array:
        """(M, 2) m, places on the opening in the direction of ``points`` (M, 2) m."""
        offset = points - self.centre
        along = offset / np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-12)
        return np.asarray(self.centre + self.radius_towards(points)[:, None] * along)


def clamp_radius(opening: Opening, points: Array, size: tuple[float, float], kind: ClampRadius) -> Array:
    """(M,) m, clamp radius that belongs to ``points`` (M, 2) m of a rectangular clamp of ``size`` m, centred at 0.

    ``equivalent``: circle of the same area, as Ren 2018 (4.3.2) reduces the square sheet. ``local``: distance from
    the middle of the opening to the clamp edge in the direction of the point, for parts that are off-centre or
    nearly fill the clamp. At least 4 % more than the radius of the opening.
    """
    if kind == "equivalent":
        radius = np.full(len(points), np.sqrt(size[0] * size[1] / np.pi))
    else:
        radius = _distance_to_edge(opening.centre, points, size)
    return np.asarray(np.maximum(radius, opening.radius_towards(points) / (1.0 - SMALLEST_GAP)))


def _distance_to_edge(centre: Array, points: Array, size: tuple[float, float]) -> Array:
    """(M,) m, from ``centre`` through each point to the rectangle's edge."""
    offset = points - centre
    direction = offset / np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-12)
    half = 0.5 * np.asarray(size)
    room = np.where(direction >= 0.0, half - centre, half + centre)
    return np.asarray(np.min(room / np.maximum(np.abs(direction), 1e-12), axis=1))
