"""What distinguishes the places of a contour: wall angle, curvature in plan view, curvature across the contours.

Ren 2018, 4.2.5: phi from the normal, rho_1 from a circle through neighbours on the loop, rho_2 from one through
neighbours on the loops above and below; circles fitted after Pratt (1987).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.types import Array
from scipy.spatial import cKDTree

from isf_springback.loop_path import LoopPath

REFERENCE_ANGLE = np.radians(45.0)
"""rad, the wall angle that counts as one (published)."""


@dataclass(frozen=True)
class LoopFeatures:
    """Features of the N points of a contour.

    Attributes
    ----------
    wall_angle : (N,) rad
    curvature : (N,) 1/m, 1 / rho_1 in plan view, positive where the loop is convex
    across : (N,) 1/m, 1 / rho_2 in the vertical plane across the loop, positive where the wall steepens downwards
    """

    wall_angle: Array
    curvature: Array
    across: Array

    def normalised(self, tool_radius: float, *, with_across: bool = False) -> Array:
        """(N, 2 or 3) angle over 45 deg and curvatures over that of the tool."""
        columns = [self.wall_angle / REFERENCE_ANGLE, self.curvature * tool_radius]
        if with_across:
            columns.append(self.across * tool_radius)
        return np.column_stack(columns)


def loop_features(contour: Contour, tool_radius: float, neighbours: tuple[Contour, ...] = ()) -> LoopFeatures:
    """Features of ``contour``; curvature over a window of one ``tool_radius`` m of path to either side.

    ``neighbours`` are the loops above and below; without two of them ``across`` is zero.
    """
    path = LoopPath.through(contour.contact[:, :2], closed=contour.closed)
    reach = max(2, round(tool_radius * len(path) / path.length))
    window = np.arange(-reach, reach + 1)
    index = np.arange(len(contour))[:, None] + window
    index = index % len(contour) if contour.closed else np.clip(index, 0, len(contour) - 1)
    loop = contour.contact[:, :2]
    curvature, centre_side = _signed_curvature(loop[index])
    turn = np.sign(_area(loop)) if contour.closed else 1.0
    # the wall angle of a plan is that of facets or of a smooth surface: nothing to filter here
    wall_angle = np.arccos(np.clip(np.abs(contour.normal[:, 2]), 0.0, 1.0))
    return LoopFeatures(wall_angle, turn * centre_side * curvature, _across(contour, neighbours))


def pratt_circle(points: Array) -> tuple[Array, Array]:
    """Centres (N, 2) m and curvatures (N,) 1/m of circles through ``points`` (N, K, 2) m.

    Minimises sum (A r^2 + B x + C y + D)^2 with B^2 + C^2 - 4 A D = 1 (Pratt 1987); points on a line give curvature
    zero and a centre that is far but finite.
    """
    middle = points.mean(axis=1, keepdims=True)
    offset = points - middle
    scale = np.maximum(np.sqrt((offset**2).sum(axis=2).mean(axis=1)), 1e-12)
    offset = offset / scale[:, None, None]
    square = (offset**2).sum(axis=2)
    rows = np.stack([square, offset[..., 0], offset[..., 1], np.ones_like(square)], axis=2)
    moments = rows.transpose(0, 2, 1) @ rows / points.shape[1]
    inverse_constraint = np.array([[0, 0, 0, -0.5], [0, 1, 0, 0], [0, 0, 1, 0], [-0.5, 0, 0, 0]])
    values, vectors = np.linalg.eig(inverse_constraint @ moments)
    values = np.where(values.real > -1e-9, values.real, np.inf)  # one of the four is negative
    best = np.argmin(values, axis=1)
    a, b, c, d = vectors.real[np.arange(len(points)), :, best].T
    norm = np.sqrt(np.maximum(b**2 + c**2 - 4 * a * d, 1e-30))
    curvature = 2 * np.abs(a) / norm
    bounded = np.where(np.abs(a) < 1e-9, np.where(a < 0, -1e-9, 1e-9), a)
    centre = -np.stack([b, c], axis=1) / (2 * bounded[:, None])
    return centre * scale[:, None] + middle[:, 0], curvature / scale


def _signed_curvature(windows: Array) -> tuple[Array, Array]:
    """(N,) 1/m and the side of the centre, +1 left of the path."""
    centre, curvature = pratt_circle(windows)
    half = windows.shape[1] // 2
    along = windows[:, half + 1] - windows[:, half - 1]
    towards = centre - windows[:, half]
    return curvature, np.sign(along[:, 0] * towards[:, 1] - along[:, 1] * towards[:, 0])


def _area(loop: Array) -> float:
    x, y = loop[:, 0], loop[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _across(contour: Contour, neighbours: tuple[Contour, ...]) -> Array:
    """(N,) 1/m, from the nearest points of the loops above and below."""
    if len(neighbours) != 2:
        return np.zeros(len(contour))
    above, below = neighbours
    here = contour.contact
    across = np.stack([above.contact[cKDTree(above.contact[:, :2]).query(here[:, :2])[1]], here], axis=1)
    across = np.concatenate(
        [across, below.contact[cKDTree(below.contact[:, :2]).query(here[:, :2])[1]][:, None]], axis=1
    )
    step = np.linalg.norm(np.diff(across[..., :2], axis=1), axis=2)
    run = np.column_stack([-step[:, 0], np.zeros(len(here)), step[:, 1]])
    section = np.stack([run, across[..., 2]], axis=2)
    curvature, side = _signed_curvature(section)
    push = 1.0 if float(below.contact[:, 2].mean()) < float(above.contact[:, 2].mean()) else -1.0
    return -push * side * curvature
