"""Errors of a part read from its scanned shape around one contour: on the wall above it and on the bottom inside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_springback.loop_path import LoopPath
from isf_springback.scan_processing import FormedShape, sections

PLACES = 36
"""Places around a contour at which bias is kept (assumed)."""
WALL_REACH = (-0.75e-3, 0.1e-3)
"""m from the contact, where the wall is read: passed by the contact within the last two contours."""
READING_DEVIATION = 0.15e-3
"""m, of an error read in a section: 0.05 mm of the scanner (published: Lu 2016, 3.5.2), the rest for what one contour
leaves of the next one's wall (assumed)."""


@dataclass(frozen=True)
class Reading:
    """Errors read around one contour, M places: formed minus intended height on the wall and on the bottom, m."""

    place: Array
    wall: Array
    bottom: Array


def read_errors(contour: Contour, shape: FormedShape, target: HeightMap, radius: float) -> Reading:
    """Errors on the wall just above the contact and on the bottom, at :data:`PLACES` places of ``contour``."""
    path = LoopPath.of(contour)
    directions = sections.directions_of(contour, path.even_positions(PLACES))
    angle = path.at(contour.wall_angle, directions.position)
    step = sections.STEP
    reach = step * np.arange(-12, round(20e-3 / step) + 1, dtype=np.float64)
    formed = sections.vertical_sections(shape.surface, directions, reach)
    wanted = sections.vertical_sections(target, directions, reach)
    near = (reach >= WALL_REACH[0] - 1e-9) & (reach <= WALL_REACH[1] + 1e-9)
    wall = _median(formed[:, near] - wanted[:, near])
    tip = radius * np.sin(angle)
    level = directions.tip_level
    inside = (reach[None, :] >= tip[:, None] - 0.5e-3) & (reach[None, :] <= tip[:, None] + _inner(contour))
    flat = wanted <= level[:, None] + 0.05e-3
    bottom = _median(np.where(inside & flat, formed - level[:, None], np.nan))
    return Reading(directions.origin, wall, bottom)


def _inner(contour: Contour) -> float:
    """m, how far inside the tip the bottom is read: half of the way to the middle."""
    place = contour.forming_tip[:, :2]
    return float(np.clip(0.25 * np.ptp(place, axis=0).min(), 0.5e-3, 15e-3))


def _median(values: Array) -> Array:
    """(M,) median of the known values of each row; NaN where less than a quarter of the row is known."""
    result = np.full(len(values), np.nan)
    enough = np.isfinite(values).sum(axis=1) >= 2
    result[enough] = np.nanmedian(values[enough], axis=1)
    return result
