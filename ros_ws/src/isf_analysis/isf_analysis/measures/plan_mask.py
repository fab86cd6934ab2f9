"""Masks in plan: which points of a shape count, by circles, boxes and polygons or by regions of a target.

Lengths in m, in the frame of the shape that is compared with; what people write is in mm.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import MEGABYTE, read_text, reason
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Mask

from isf_analysis.measures.deviation import REGIONS, regions_of

MM = 1e3
GRAMMAR = "circle:X,Y,R, box:X0,Y0,X1,Y1 or polygon:FILE.csv with x and y of every corner (mm)"
ROUND = 180
"""Corners of the outline of a circle, as drawn; what it holds is exact."""
LARGEST_OUTLINE = MEGABYTE
"""bytes of a file of corners: 50,000 of them, which are checked against each other."""


@dataclass(frozen=True)
class PlanShape:
    """What a part of the plan is: ``outline`` (N, 2) m, closed; a circle has ``radius`` m about ``centre`` (x, y) m."""

    outline: Array
    centre: tuple[float, float] = (0.0, 0.0)
    radius: float | None = None

    def holds(self, points: Array) -> Mask:
        """(P,) bool of ``points`` (P, 2 or more) m, those on the outline too."""
        x, y = points[:, 0], points[:, 1]
        if self.radius is not None:
            return np.asarray(np.hypot(x - self.centre[0], y - self.centre[1]) <= self.radius)
        polygon = shapely.Polygon(self.outline)
        shapely.prepare(polygon)
        return np.asarray(shapely.intersects_xy(polygon, x, y))


@dataclass(frozen=True)
class PlanMask:
    """Points count that lie in one of ``inside`` (if any), in none of ``outside``, and in ``region`` of ``target``.

    ``region`` (ny, nx) bool of the cells of ``target``; None: anywhere.
    """

    inside: tuple[PlanShape, ...] = ()
    outside: tuple[PlanShape, ...] = ()
    target: HeightMap | None = None
    region: Mask | None = None

    def counts(self, points: Array) -> Mask:
        """(P,) bool of ``points`` (P, 2 or more) m."""
        found = np.ones(len(points), dtype=bool)
        if self.inside:
            found &= np.any([shape.holds(points) for shape in self.inside], axis=0)
        for shape in self.outside:
            found &= ~shape.holds(points)
        if self.target is not None and self.region is not None:
            found &= _in_cells(self.target, self.region, points)
        return found


def _in_cells(target: HeightMap, region: Mask, points: Array) -> Mask:
    """Whether the cell of ``target`` around each point, a node in its middle, is in ``region``; beside it none is."""
    place, within = [], np.ones(len(points), dtype=bool)
    for axis, value in ((target.y, points[:, 1]), (target.x, points[:, 0])):
        cell = np.floor((value - axis[0]) / (axis[-1] - axis[0]) * (len(axis) - 1) + 0.5)
        within &= (cell >= 0) & (cell < len(axis))
        place.append(np.clip(cell, 0, len(axis) - 1).astype(np.int64))
    return np.asarray(within & region[place[0], place[1]])


def region_of(target: HeightMap, names: Iterable[str]) -> Mask:
    """(ny, nx) bool, cells of ``target`` that are in one of the regions ``names``.

    Raises
    ------
    IsfError : FILE_FIELD, no such region, or one that this target has no cell of; BAG_INCOMPLETE, a flat target
    """
    masks = regions_of(target)
    found = np.zeros(target.z.shape, dtype=bool)
    for name in names:
        if name not in masks:
            raise _refused("--region", f"no region '{name}'", ", ".join(REGIONS))
        if not masks[name].any():
            raise _refused("--region", f"the target has no {name}", "another region, or --inside")
        found |= masks[name]
    return found


def shapes_of(texts: Iterable[str], option: str) -> tuple[PlanShape, ...]:
    """What ``texts`` of the command line's ``option`` name, such as ``circle:0,0,12`` (mm).

    Raises
    ------
    IsfError : FILE_FIELD, a text is no shape; FILE_NOT_FOUND, FILE_SYNTAX of the file of a polygon
    """
    return tuple(_shape(text, option) for text in texts)


def _shape(text: str, option: str) -> PlanShape:
    kind, _, rest = (part.strip() for part in text.partition(":"))
    if kind == "polygon" and rest:
        return PlanShape(_polygon(Path(rest)))
    try:
        values = [float(value) / MM for value in rest.split(",")]
    except ValueError:
        values = []
    if all(map(math.isfinite, values)):
        if kind == "circle" and len(values) == 3 and values[2] > 0.0:
            x, y, radius = values
            phi = np.linspace(0.0, 2.0 * np.pi, ROUND + 1)
            outline = np.array([x, y]) + radius * np.column_stack([np.cos(phi), np.sin(phi)])
            return PlanShape(outline, (x, y), radius)
        if kind == "box" and len(values) == 4 and values[0] != values[2] and values[1] != values[3]:
            (x0, x1), (y0, y1) = sorted(values[::2]), sorted(values[1::2])
            return PlanShape(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]))
    raise _refused(option, f"'{text}' is no shape", GRAMMAR)


def _polygon(path: Path) -> Array:
    """(N, 2) m, closed, of a CSV file with x and y in mm, a row of names before them or none."""
    try:
        rows = [row for row in csv.reader(read_text(path, LARGEST_OUTLINE).splitlines()) if row]
        if rows and not _number(rows[0][0]):
            rows = rows[1:]
        corners = np.array([[float(value) for value in row[:2]] for row in rows]) / MM
        if corners.ndim != 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
            raise ValueError("two numbers in every row are wanted")
        if len(np.unique(corners, axis=0)) < 3:
            raise ValueError("three corners at least are wanted")
        polygon = shapely.Polygon(corners)
        if not shapely.is_valid(polygon):
            raise ValueError(f"the outline crosses or touches itself: {shapely.is_valid_reason(polygon)} (m)")
    except FileNotFoundError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice="check the path") from error
    except (OSError, ValueError, csv.Error) as error:  # no text, no numbers, rows of different lengths
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"holds no polygon: {reason(error)}",
            where=str(path),
            advice="x and y of a corner in mm in every row, once around",
        ) from error
    return np.asarray(shapely.get_coordinates(polygon))


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _refused(option: str, what: str, advice: str) -> IsfError:
    return IsfError(ErrorCode.FILE_FIELD, what, where=option, advice=advice)
