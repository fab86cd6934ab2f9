"""A part of the library: features (an opening with a wall profile), their exact surface, and a mesh of it.

The height over a place is the sum over the features of profile(level(place)). For an opening of arcs and lines the
level is the inward distance from it, so the wall angle is the same all around; for an oblique circle it is the
distance of a family of shifted circles, so the wall angle changes around. Lengths in m, frame ``sheet``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from isf_core.types import Array

from isf_planner.part_library.arc_chain import ArcChain
from isf_planner.part_library.wall_profile import WallProfile

STRAIGHT_STEP = 4e-3
"""m, longest facet along a straight side."""


class Levels(Protocol):
    """A family of closed lines, one for each level d."""

    def level(self, points: Array) -> tuple[Array, Array]:
        """Level (N,) m of ``points`` (N, 2) m and its gradient (N, 2)."""

    def ring(self, d: float, chord: float, span: tuple[float, float]) -> Array:
        """(M, 2) m, points on the line of level ``d``; M and their order do not depend on ``d``.

        Between d = span[0] and span[1] no chord is farther than ``chord`` m from the line.
        """


@dataclass(frozen=True)
class OffsetLine:
    """Levels at equal distances inward from a closed counter-clockwise line."""

    line: ArcChain

    def level(self, points: Array) -> tuple[Array, Array]:
        return self.line.signed_distance(points)

    def ring(self, d: float, chord: float, span: tuple[float, float]) -> Array:
        piece, distance = [], []
        for k, (curvature, length) in enumerate(zip(self.line.curvature, self.line.length, strict=True)):
            if curvature == 0.0:
                count = int(np.ceil(length / STRAIGHT_STEP))
            else:
                largest = max(abs(1.0 / curvature - span[0]), abs(1.0 / curvature - span[1]))
                count = segments(largest, float(length * abs(curvature)), chord)
            piece.append(np.full(count, k))
            distance.append(length * np.arange(count) / count)
        points, inward = self.line.at(np.concatenate(piece), np.concatenate(distance))
        return points + d * inward


@dataclass(frozen=True)
class ObliqueCircle:
    """Circles of radius ``radius`` - d around centres that move by ``shift`` (2,) per d: an oblique cone."""

    radius: float
    shift: tuple[float, float]

    def level(self, points: Array) -> tuple[Array, Array]:
        e = np.asarray(self.shift)
        # |p - e d| = r - d, the smaller root
        a, b = 1.0 - e @ e, points @ e - self.radius
        c = self.radius**2 - (points**2).sum(axis=1)
        d = (-b - np.sqrt(np.maximum(b**2 - a * c, 0.0))) / a
        arm = points - d[:, None] * e
        unit = arm / np.maximum(np.linalg.norm(arm, axis=1, keepdims=True), 1e-15)
        return d, -unit / (1.0 - unit @ e)[:, None]

    def ring(self, d: float, chord: float, span: tuple[float, float]) -> Array:
        count = segments(self.radius - min(span), 2.0 * np.pi, chord)
        angle = 2.0 * np.pi * np.arange(count) / count
        circle = (self.radius - d) * np.column_stack([np.cos(angle), np.sin(angle)])
        return circle + d * np.asarray(self.shift)


@dataclass(frozen=True)
class RoundedSquare:
    """Squares whose corners keep their radius while their sides move inward: plane walls with ribs between them.

    ``half_side`` and ``corner`` (radius) of the line of level 0, m.
    """

    half_side: float
    corner: float

    def level(self, points: Array) -> tuple[Array, Array]:
        sign = np.where(points < 0.0, -1.0, 1.0)
        x, y = np.abs(points).T
        longer = np.where((x >= y)[:, None], [1.0, 0.0], [0.0, 1.0])
        d, gradient = self.half_side - np.maximum(x, y), -longer
        # in a corner: distance from its centre, which moves along the diagonal, is the radius; the larger root
        u, v = x - self.half_side + self.corner, y - self.half_side + self.corner
        half = 0.5 * (u + v)
        root = np.sqrt(np.maximum(half**2 - 0.5 * (u * u + v * v - self.corner**2), 0.0))
        corner = -half + root
        arm = np.column_stack([u + corner, v + corner])
        inside = (arm > 0.0).all(axis=1)
        slope = -arm / np.maximum(arm.sum(axis=1), 1e-15)[:, None]
        return np.where(inside, corner, d), np.where(inside[:, None], slope, gradient) * sign

    def ring(self, d: float, chord: float, span: tuple[float, float]) -> Array:
        straight, largest = self.half_side - d - self.corner, self.half_side - min(span) - self.corner
        count = segments(self.corner, 0.5 * np.pi, 0.7 * chord)  # facets of the fillets lie askew
        turn = 0.5 * np.pi * np.arange(count + 1) / count
        along = np.linspace(1.0, -1.0, max(2, int(np.ceil(2.0 * largest / STRAIGHT_STEP))) + 1)[1:-1]
        side = np.column_stack([straight * along, np.full(len(along), straight + self.corner)])
        arc = straight + self.corner * np.column_stack([np.cos(turn), np.sin(turn)])
        quarter = np.vstack([arc, side])
        turns = [np.array([[c, s], [-s, c]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
        return np.vstack([quarter @ turned for turned in turns])


@dataclass(frozen=True)
class Feature:
    """An opening and its wall.

    Attributes
    ----------
    levels : family of lines from the opening inward
    profile : height over the level
    up : the feature rises (is formed from below) instead of going down
    """

    levels: Levels
    profile: WallProfile
    up: bool = False

    def height(self, points: Array) -> tuple[Array, Array]:
        """Height (N,) m and gradient (N, 2) at ``points`` (N, 2) m."""
        d, gradient = self.levels.level(points)
        z, slope = self.profile.height(d)
        sign = -1.0 if self.up else 1.0
        return sign * z, sign * slope[:, None] * gradient


@dataclass(frozen=True)
class Part:
    """A part with one or more features.

    Attributes
    ----------
    name : of the generator
    features : the first one may hold the others on its floor, or all stand beside each other
    flange : m, plane sheet around the first feature; around several beside each other: ``outline``
    outline : half sides (x, y) m of a rectangular flange, or None
    origin : (2,) m, where the centre of the blank lies in the coordinates of the features
    """

    name: str
    features: tuple[Feature, ...]
    flange: float
    outline: tuple[float, float] | None = None
    origin: tuple[float, float] = (0.0, 0.0)

    def centred(self) -> Part:
        """The part with the middle of its outline at the centre of the blank."""
        if self.outline is not None:
            return self
        first = self.features[0]
        edge = first.profile.first - self.flange
        ring = first.levels.ring(edge, 1e-6, (edge, first.profile.last))
        middle = 0.5 * (ring.min(axis=0) + ring.max(axis=0))
        return replace(self, origin=(float(middle[0]), float(middle[1])))

    @property
    def depth(self) -> float:
        """m, deepest point below the flange."""
        first, *others = (feature.profile.depth for feature in self.features if not feature.up)
        deepest = max(others, default=0.0)
        return first + deepest if self.outline is None else max(first, deepest)

    def height(self, points: Array) -> Array:
        """(N,) m, z of the upper face at ``points`` (N, 2) m."""
        return np.sum([feature.height(points + self.origin)[0] for feature in self.features], axis=0)

    def normal(self, points: Array) -> Array:
        """(N, 3) upward unit normals of the upper face at ``points`` (N, 2) m."""
        gradient = np.sum([feature.height(points + self.origin)[1] for feature in self.features], axis=0)
        normal = np.column_stack([-gradient, np.ones(len(points))])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    def distance(self, points: Array) -> Array:
        """(N,) m, of ``points`` (N, 3) m near the upper face, positive above it: height error times cos(wall angle).

        Exact to the square of the distance times the curvature: 0.01 um at 10 um beside a radius of 5 mm.
        """
        return (points[:, 2] - self.height(points[:, :2])) * self.normal(points[:, :2])[:, 2]


def segments(radius: float, angle: float, chord: float) -> int:
    """Equal chords that stay within ``chord`` m of an arc of ``radius`` m over ``angle`` rad; at least one."""
    if radius <= chord:
        return max(1, int(np.ceil(2.0 * angle / np.pi)))
    return max(1, int(np.ceil(angle / (2.0 * np.arccos(1.0 - chord / radius)))))
