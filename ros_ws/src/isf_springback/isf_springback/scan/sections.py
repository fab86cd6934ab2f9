"""Vertical and horizontal sections of a shape along directions that belong to a contour, and contact detection.

A *section* runs in plan view from outside the opening inwards through a point of the contour. ``reach`` is the
distance along it, 0 at the point of the contour, positive inwards, so that Lu's index from the edge to the centre
(2016, 3.2.1) is the order of the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray
from scipy import ndimage

from isf_springback.loop_path import LoopPath

STEP = 0.25e-3
"""m, distance of the samples of a section."""


@dataclass(frozen=True)
class Directions:
    """M section directions of a contour.

    Attributes
    ----------
    position : (M,) m along the contour
    origin : (M, 2) m, contact points of the contour in plan view
    outward : (M, 2) unit, away from the formed pocket
    contact_level, tip_level : (M,) m, z of contact and forming tip
    """

    position: Array
    origin: Array
    outward: Array
    contact_level: Array
    tip_level: Array

    def __len__(self) -> int:
        return len(self.position)


def directions_of(contour: Contour, position: Array) -> Directions:
    """Directions through the points at ``position`` (M,) m of the path of the forming tip, square to it."""
    path = LoopPath.of(contour)
    columns = [path.at(contour.contact[:, axis], position) for axis in range(3)]
    tip = path.at(contour.forming_tip[:, 2], position)
    outward = outward_normals(contour)
    nx, ny = path.at(outward[:, 0], position), path.at(outward[:, 1], position)
    size = np.maximum(np.hypot(nx, ny), 1e-12)
    return Directions(position, np.column_stack(columns[:2]), np.column_stack([nx / size, ny / size]), columns[2], tip)


def outward_normals(contour: Contour) -> Array:
    """(N, 2) unit, square to the path in plan view, away from the enclosed area.

    On an open path the side of the horizontal part of the sheet normal is inward.
    """
    place = contour.forming_tip[:, :2]
    if contour.closed:
        tangent = np.roll(place, -1, axis=0) - np.roll(place, 1, axis=0)
        following = np.roll(place, -1, axis=0)
        area = float(np.sum(place[:, 0] * following[:, 1] - place[:, 1] * following[:, 0]))
        sign = 1.0 if area > 0 else -1.0
    else:
        tangent = np.gradient(place, axis=0)
        lean = np.sum(tangent[:, 1] * contour.normal[:, 0] - tangent[:, 0] * contour.normal[:, 1])
        sign = -1.0 if lean > 0 else 1.0
    normal = sign * np.column_stack([tangent[:, 1], -tangent[:, 0]])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(normal / np.maximum(size, 1e-12))


def heights_at(surface: HeightMap, places: Array) -> Array:
    """(...,) m, bilinear heights at ``places`` (..., 2) m; NaN outside and beside unknown cells."""
    pitch_x, pitch_y = surface.x[1] - surface.x[0], surface.y[1] - surface.y[0]
    row = (places[..., 1] - surface.y[0]) / pitch_y
    column = (places[..., 0] - surface.x[0]) / pitch_x
    return np.asarray(
        ndimage.map_coordinates(surface.z, [row, column], order=1, mode="constant", cval=np.nan, prefilter=False)
    )


def vertical_sections(surface: HeightMap, directions: Directions, reach: Array) -> Array:
    """(M, n) m, heights along every direction at ``reach`` (n,) m inwards of the contact."""
    places = directions.origin[:, None, :] - reach[None, :, None] * directions.outward[:, None, :]
    return heights_at(surface, places)


def crossing(profile: Array, reach: Array, level: Array) -> Array:
    """(M,) m, where each profile (M, n) first falls through ``level`` (M,) from outside; NaN where it is not seen.

    The horizontal section at one level: the place of the wall in every direction.
    """
    below = profile <= level[:, None]
    with np.errstate(invalid="ignore"):
        falls = ~below[:, :-1] & below[:, 1:] & np.isfinite(profile[:, :-1]) & np.isfinite(profile[:, 1:])
    first = np.argmax(falls, axis=1)
    rows = np.arange(len(profile))
    high, low = profile[rows, first], profile[rows, first + 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (high - level) / (high - low)
    place = reach[first] + share * (reach[first + 1] - reach[first])
    return np.asarray(np.where(falls.any(axis=1), place, np.nan))


def contact_reach(profile: Array, reach: Array, wall_angle: Array, share: float = 0.85) -> Array:
    """(M,) m, innermost place where a profile still has the slope of the wall: the tangency of ball and wall.

    ``wall_angle`` (M,) rad of the wall just above; the slope counts as the wall's down to ``share`` of its tangent.
    NaN where the wall is not seen.
    """
    size = max(3, 2 * round(0.5e-3 / STEP) + 1)
    smooth = ndimage.uniform_filter1d(profile, size, axis=1, mode="nearest")
    slope = -np.gradient(smooth, reach, axis=1)
    with np.errstate(invalid="ignore"):
        wall = slope >= share * np.tan(wall_angle)[:, None]
    last = profile.shape[1] - 1 - np.argmax(wall[:, ::-1], axis=1)
    return np.asarray(np.where(wall.any(axis=1), reach[last], np.nan))


def dropped_ball(profile: Array, radius: float) -> tuple[Array, NDArray[np.intp]]:
    """Tip heights (M, n) m of a ball of ``radius`` m dropped on each profile, and the sample (M, n) it touches.

    Samples are :data:`STEP` apart; unknown ones do not carry the ball.
    """
    half = int(np.floor(radius / STEP))
    away = STEP * np.arange(-half, half + 1)
    cap = np.sqrt(np.maximum(radius**2 - away**2, 0.0)) - radius
    known = np.where(np.isfinite(profile), profile, -np.inf)
    padded = np.pad(known, ((0, 0), (half, half)), constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=1) + cap
    touch = np.argmax(windows, axis=2)
    tip = np.take_along_axis(windows, touch[:, :, None], axis=2)[:, :, 0]
    return np.asarray(tip), np.asarray(np.clip(touch + np.arange(profile.shape[1]) - half, 0, profile.shape[1] - 1))
