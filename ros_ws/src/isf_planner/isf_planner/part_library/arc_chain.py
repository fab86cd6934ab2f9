"""Smooth chains of circular arcs and straight lines in a plane: openings of parts and profiles of walls.

Everything about them is known in closed form: points, normals, and the signed distance of any point. That makes
the parts of this library oracles: their surfaces are exact, the mesh is only a picture of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.types import Array
from numpy.typing import ArrayLike, NDArray

LARGEST_SWEEP = 1.5 * np.pi
"""rad; a belt that turns farther around one circle crosses itself."""

_SHORTEST = 1e-12
"""m, pieces below this are left out."""


@dataclass(frozen=True)
class ArcChain:
    """K pieces, each beginning where the one before ends, in the same direction.

    Attributes
    ----------
    start : (K, 2) m ; heading : (K,) rad, direction at the start of each piece
    curvature : (K,) 1/m, positive to the left, 0 on straight lines ; length : (K,) m
    """

    start: Array
    heading: Array
    curvature: Array
    length: Array

    @property
    def total(self) -> float:
        """m, length of the whole chain."""
        return float(self.length.sum())

    def at(self, piece: NDArray[np.int64], distance: Array) -> tuple[Array, Array]:
        """Points (N, 2) m and left unit normals (N, 2) at ``distance`` (N,) m along the pieces ``piece`` (N,)."""
        heading, curvature = self.heading[piece], self.curvature[piece]
        turned = heading + curvature * distance
        straight = np.column_stack([np.cos(heading), np.sin(heading)]) * distance[:, None]
        safe = np.where(curvature == 0.0, 1.0, curvature)
        arc = np.column_stack([np.sin(turned) - np.sin(heading), np.cos(heading) - np.cos(turned)]) / safe[:, None]
        points = self.start[piece] + np.where((curvature == 0.0)[:, None], straight, arc)
        return points, np.column_stack([-np.sin(turned), np.cos(turned)])

    def signed_distance(self, points: Array) -> tuple[Array, Array]:
        """Distance (N,) m of ``points`` (N, 2) m, positive to the left, and the left unit normals (N, 2) there."""
        best = np.full(len(points), np.inf)
        signed, normal = np.zeros(len(points)), np.zeros((len(points), 2))
        for k in range(len(self.length)):
            along = self._nearest(k, points)
            foot, left = self.at(np.full(len(points), k), along)
            offset = points - foot
            distance = np.linalg.norm(offset, axis=1)
            side = (offset * left).sum(axis=1)
            closer = distance < best
            best[closer] = distance[closer]
            signed[closer] = np.where(side < 0.0, -distance, distance)[closer]
            normal[closer] = left[closer]
        return signed, normal

    def _nearest(self, k: int, points: Array) -> Array:
        """(N,) m, how far along piece ``k`` its nearest point to each of ``points`` lies."""
        heading, curvature, length = self.heading[k], self.curvature[k], self.length[k]
        offset = points - self.start[k]
        if curvature == 0.0:
            return np.clip(offset @ np.array([np.cos(heading), np.sin(heading)]), 0.0, length)
        radius, side = 1.0 / abs(curvature), np.sign(curvature)
        centre = side * radius * np.array([-np.sin(heading), np.cos(heading)])
        arm = offset - centre
        # direction of travel at the foot, measured from the heading at the start in the sense of the turn
        travel = np.arctan2(side * arm[:, 0], -side * arm[:, 1])
        turn = side * (travel - heading)
        sweep = abs(curvature) * length
        # the range of 2 pi is centred on the arc, so that what lies beyond either end is clipped to that end
        turn = (turn - 0.5 * sweep + np.pi) % (2.0 * np.pi) - np.pi + 0.5 * sweep
        return np.asarray(np.clip(turn, 0.0, sweep) * radius)


def chain_of(start: ArrayLike, heading: float, pieces: Sequence[tuple[float, float]]) -> ArcChain:
    """Chain from ``start`` (2,) m and ``heading`` rad; each piece is (curvature 1/m, length m)."""
    kept = [(curvature, length) for curvature, length in pieces if length > _SHORTEST]
    point, starts, headings = np.asarray(start, dtype=float), [], []
    for curvature, length in kept:
        starts.append(point)
        headings.append(heading)
        single = ArcChain(point[None], np.array([heading]), np.array([curvature]), np.array([length]))
        point = single.at(np.array([0]), np.array([length]))[0][0]
        heading += curvature * length
    return ArcChain(
        np.array(starts), np.array(headings), np.array([c for c, _ in kept]), np.array([length for _, length in kept])
    )


def belt(centres: ArrayLike, radii: ArrayLike) -> ArcChain:
    """Closed line around circles like a belt around pulleys, joined by their common tangents.

    ``centres`` (K, 2) m in counter-clockwise order of travel; ``radii`` (K,) m, negative where the line turns right
    (a concave corner).

    Raises
    ------
    ValueError : two circles that follow each other have no such tangent, or the line winds around one
    """
    centre, radius = np.asarray(centres, dtype=float), np.asarray(radii, dtype=float)
    if len(centre) == 1:
        return chain_of(centre[0] + [radius[0], 0.0], np.pi / 2, [(1.0 / radius[0], 2.0 * np.pi * radius[0])])
    way = np.roll(centre, -1, axis=0) - centre
    apart = np.linalg.norm(way, axis=1)
    change = np.roll(radius, -1) - radius
    apart_enough = apart > np.abs(change)
    if not apart_enough.all():
        raise ValueError(f"circle {int(np.argmin(apart_enough))} and the next one have no common tangent")
    ratio = change / apart
    leaving = np.arctan2(way[:, 1], way[:, 0]) - np.arcsin(ratio)
    arriving = np.roll(leaving, 1)
    tangent = apart * np.sqrt(1.0 - ratio**2)
    pieces: list[tuple[float, float]] = []
    for k in range(len(centre)):
        side = np.sign(radius[k])
        sweep = (side * (leaving[k] - arriving[k]) + 1e-9) % (2.0 * np.pi) - 1e-9
        if sweep > LARGEST_SWEEP:
            raise ValueError(f"the line would wind around circle {k}: move it, or change the side it is passed on")
        pieces += [(1.0 / radius[k], float(sweep * abs(radius[k]))), (0.0, float(tangent[k]))]
    first = centre[0] - radius[0] * np.array([-np.sin(arriving[0]), np.cos(arriving[0])])
    return chain_of(first, float(arriving[0]), pieces)


def rounded_polygon(corners: ArrayLike, radii: ArrayLike) -> ArcChain:
    """Counter-clockwise polygon with ``corners`` (K, 2) m rounded with ``radii`` (K,) m; reentrant corners too."""
    corner, radius = np.asarray(corners, dtype=float), np.asarray(radii, dtype=float)
    side = np.roll(corner, -1, axis=0) - corner
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    left = np.column_stack([-side[:, 1], side[:, 0]])
    before = np.roll(left, 1, axis=0)
    middle = (left + before) / np.linalg.norm(left + before, axis=1, keepdims=True)
    turn = np.roll(side, 1, axis=0)
    convex = np.sign(turn[:, 0] * side[:, 1] - turn[:, 1] * side[:, 0])
    half_cosine = (middle * left).sum(axis=1)
    signed = convex * radius
    return belt(corner + (signed / half_cosine)[:, None] * middle, signed)
