"""The chain of shapes from a part to the flat blank, and the joint of each to the flange (Behera 2015).

Shapes are made from the part on, by the rules of :mod:`isf_planner.morphing.rules`, and formed the other way round: the
flattest first. Three methods:

* ``scaling``: shape k is the part, less deep: walls stay walls, and what lies below them goes along.
* ``diffusion`` (default): shape k is the part diffused over the length l_k, each by half longer than the one before,
  times the speed of the feature. Depth and slope fall from shape to shape.
* ``laplacian``: the published one, least squares with the weight chi, repeated on what came out; the weight of a
  feature falls with its number of steps. It overshoots on the way.

No shape may lie below the part, as no sheet is ever formed back: what would is lifted onto it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from scipy import ndimage

from isf_planner.morphing.joint import joined
from isf_planner.morphing.laplacian import AnchoredLaplacian, diffused, grid_edges, uniform
from isf_planner.morphing.rules import MOST, MorphRules
from isf_planner.surface import height_grid

Method = Literal["scaling", "diffusion", "laplacian"]

SHORTEST = 3.0
"""Shortest length of a diffusion, over the pitch of the grid."""

LONGER = 1.5
"""Length of a diffusion over that of the one before."""

FLAT = 0.02
"""Depth of the last shape of a chain, over that of the part."""

SCALED = 50
"""Shapes from the part to the flat blank by scaling; between two of them any is in proportion."""

MOST_SHAPES = 60
"""Shapes after which a chain ends, flat or not."""


@dataclass(frozen=True)
class Chain:
    """Shapes from the part (0) to the flat blank (K), on one grid with the flange at z = 0.

    Attributes
    ----------
    x, y : (nx,), (ny,) m ; z : (K + 1, ny, nx) m
    rules : what moves, and how far
    joint : width m, and share of the chord that the control lengths have
    """

    x: Array
    y: Array
    z: Array
    rules: MorphRules
    joint: tuple[float, float]

    @property
    def length(self) -> int:
        """K, where the chain ends."""
        return len(self.z) - 1

    def shape(self, at: float) -> HeightMap:
        """The shape ``at`` 0 (the part) to K (flat), between two shapes in proportion; joined and above the part.

        The joint is as wide as given from shape 1 on, and narrows towards the part, which has none.
        """
        width, share = self.joint
        z = joined(self._between(at), self.rules.fixed, float(self.x[1] - self.x[0]), min(at, 1.0) * width, share)
        return HeightMap(self.x, self.y, np.maximum(z, self.z[0]))

    def lifted(self, at: float) -> tuple[float, Array]:
        """m, by how much the shape ``at`` is lifted onto the part at most, inside its joint; and where (2,) m."""
        pitch = float(self.x[1] - self.x[0])
        inside = ndimage.distance_transform_edt(~self.rules.fixed) * pitch > self.joint[0]
        below = np.where(inside, self.z[0] - self._between(at), 0.0)
        row, column = np.unravel_index(int(np.argmax(below)), below.shape)
        return max(0.0, float(below[row, column])), np.array([self.x[column], self.y[row]])

    def _between(self, at: float) -> Array:
        k = min(int(at), self.length - 1)
        return np.asarray((1.0 - (at - k)) * self.z[k] + (at - k) * self.z[k + 1])


def make_chain(
    part: HeightMap,
    rules: MorphRules,
    joint: tuple[float, float],
    method: Method = "diffusion",
    chi: float = 3e-4,
) -> Chain:
    """Chain of the ``part``, whose flange lies at z = 0; ``chi``: weight of the old shape in method laplacian."""
    if method == "scaling":
        shapes = [part.z * (1.0 - k / SCALED) for k in range(SCALED + 1)]
    elif method == "diffusion":
        shapes = _by_diffusion(part, rules)
    else:
        shapes = _by_least_squares(part, rules, chi)
    return Chain(part.x, part.y, np.array(shapes), rules, joint)


def _by_diffusion(part: HeightMap, rules: MorphRules) -> list[Array]:
    edges = grid_edges(part.z.shape)
    free = ~rules.fixed.ravel()
    shapes = [part.z]
    depth = -float(part.z.min())
    length = SHORTEST
    for _ in range(MOST_SHAPES):
        # four neighbours at one pitch: L is -1/4 of the Laplacian, and mu = 1 / (4 l^2) diffuses over l pitches
        mu = 0.25 / (length * rules.speed.ravel()) ** 2
        z = diffused(edges, free, mu, part.z.ravel()).reshape(part.z.shape)
        shapes.append(z)
        if -z.min() < FLAT * depth:
            break
        length *= LONGER
    return shapes


def _by_least_squares(part: HeightMap, rules: MorphRules, chi: float) -> list[Array]:
    laplacian = uniform(grid_edges(part.z.shape), part.z.size)
    steps = rules.steps.ravel()
    weight = chi * MOST / steps.astype(float)
    shapes = [part.z]
    depth = -float(part.z.min())
    solver = AnchoredLaplacian(laplacian, ~rules.fixed.ravel(), weight)
    z = part.z.ravel()[:, None]
    for _ in range(MOST_SHAPES):
        z = solver.apply(z)
        # what overshoots would be kept as the next anchor: it is taken back at once
        z = np.maximum(z, part.z.ravel()[:, None])
        shapes.append(z.reshape(part.z.shape))
        if -z.min() < FLAT * depth:
            break
    return shapes


def on_finer_grid(shape: HeightMap, part: HeightMap) -> HeightMap:
    """``shape`` on the nodes of ``part``, a finer grid, and above it."""
    clipped = np.clip(part.points()[:, :2], [shape.x[0], shape.y[0]], [shape.x[-1], shape.y[-1]])
    return HeightMap(part.x, part.y, np.maximum(shape.at(clipped).reshape(part.z.shape), part.z))


def steepest_place(shape: HeightMap) -> Array:
    """(3,) m, the node of ``shape`` with the largest slope."""
    along_x, along_y = shape.gradient()
    row, column = np.unravel_index(int(np.argmax(np.hypot(along_x, along_y))), shape.z.shape)
    return np.array([shape.x[column], shape.y[row], shape.z[row, column]])


def steepest(shape: HeightMap) -> float:
    """rad, wall angle that only a thousandth of the shape's inclined facets exceed."""
    pitch = height_grid.pitch_of(shape)
    rise_x, rise_y = np.diff(shape.z, axis=1) / pitch, np.diff(shape.z, axis=0) / pitch
    # the two facets of a cell: a-b-c and a-c-d
    slope = np.hypot(np.stack([rise_x[:-1], rise_x[1:]]), np.stack([rise_y[:, 1:], rise_y[:, :-1]])).ravel()
    inclined = slope[slope > 0.05]
    return float(np.arctan(np.quantile(inclined, 0.999))) if len(inclined) else 0.0
