"""Scans as they are in a bag: which one is of the finished part, and a height map from points in no order.

The simulated machine's exact shape is a grid; a scanner's cloud is unordered, of float32 or float64.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_ros import fields
from numpy.typing import NDArray
from scipy import ndimage

from isf_analysis.measures.deviation import regions_of

SCAN_TOLERANCE = 1e-6
"""s by which the stamp of a scan may lie before the end of the contour it was made after: rounding of stamps."""

REACH = 2
"""Cells next to measured ones that are filled from them, so that sparse points leave no holes."""

SIZES = (0.2, 5.0)
"""Extent of a scan in plan over that of the part, and over that of the whole sheet, below and beyond which its unit is
wrong: the limits of springback correction."""


def final_scans(scans: Sequence[tuple[int, Any]], formed: float, begun: int = 0, ended: int = 0) -> list[Any]:
    """The scans after which nothing was formed; a scan between contours is not of the finished part.

    ``scans`` are (receive time ns, message). Stamps decide, for a busy recorder may receive a scan before the result
    that it was asked for because of: ``formed`` is the time at which the last contour ended, s by the clock of stamps.
    Where a contour was begun and its end is not known, or nothing tells when one ended (``formed`` infinite), a scan
    counts that came after ``begun``, the receive time (ns) of that contour. One without a stamp counts when it came
    after ``ended``, the receive time (ns) of the last contour or result.
    """

    def final(time: int, message: Any) -> bool:
        stamp = stamp_of(message)
        if stamp == 0.0:
            return time >= ended
        return time >= begun and (math.isinf(formed) or stamp >= formed - SCAN_TOLERANCE)

    return [message for time, message in scans if final(time, message)]


def stamp_of(message: Any) -> float:
    """s, stamp of a cloud."""
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def height_map_of(message: Any, target: HeightMap | None) -> HeightMap:
    """Height map of a scan; points in no order are read at the cells of ``target``.

    A cell gets the target's height plus the median deviation of its points: where in the cell they lie does not matter
    on a wall, and a few outliers do not either. Cells without points get the mean deviation of those beside them, up
    to ``REACH`` cells far; beyond that they are NaN.

    Raises
    ------
    IsfError : SCAN_NOT_FINITE when no point of it is known; SCAN_UNIT_SUSPECT; BAG_INCOMPLETE when the cloud is not of
        points, or is unordered and there is no target, or none of its points lies on that
    """
    points = points_of(message)
    if not len(points):
        raise IsfError(
            ErrorCode.SCAN_NOT_FINITE,
            f"of its {message.width * message.height} points none is finite",
            where="scan",
            advice="check the scanner; glossy sheet may need a matt spray",
        )
    if target is not None and not sized(points, target):
        extent, sheet = _extent(points), (np.ptp(target.x), np.ptp(target.y))
        raise IsfError(
            ErrorCode.SCAN_UNIT_SUSPECT,
            f"its points span {extent[0]:.4g} x {extent[1]:.4g} m, the sheet {sheet[0]:.4g} x {sheet[1]:.4g} m",
            where="scan",
            advice="coordinates must be in metres",
        )
    try:
        return fields.height_map_of(message)
    except ValueError:
        pass
    if target is None:
        raise _unusable("the scan is not on a grid, and there is no target whose grid could be used")
    found = on_cells(points, target)
    if found is None:
        raise _unusable("no point of the scan lies on the target's grid")
    return HeightMap(target.x, target.y, target.z + filled(found.z - target.z))


def sized(points: Array, target: HeightMap) -> bool:
    """False where ``points`` (P, 3) m, all finite, are none, or of another size than the part in ``target``: their unit
    is wrong."""
    if not len(points):
        return False
    extent, part = float(_extent(points).max()), 0.0
    sheet = max(float(np.ptp(target.x)), float(np.ptp(target.y)))
    with suppress(IsfError):  # a flat target is told where the two are compared
        opening = regions_of(target)["wall_and_base"]
        part = max(float(np.ptp(target.x[opening.any(axis=0)])), float(np.ptp(target.y[opening.any(axis=1)])))
    return SIZES[0] * part <= extent <= SIZES[1] * sheet


def _extent(points: Array) -> Array:
    """(2,) m in plan, but for a few outliers."""
    low, high = np.percentile(points[:, :2], (2, 98), axis=0)
    return np.asarray(high - low)


def on_cells(points: Array, target: HeightMap) -> HeightMap | None:
    """Heights on the grid of ``target`` from ``points`` (P, 3) m, NaN in cells without points; None: none is on it.

    A cell gets the target's height plus the median deviation of its points.
    """
    columns, rows = (_cells(axis, points[:, k]) for k, axis in enumerate((target.x, target.y)))
    inside = (columns >= 0) & (columns < len(target.x)) & (rows >= 0) & (rows < len(target.y))
    cell = rows[inside] * len(target.x) + columns[inside]
    deviation = points[inside, 2] - target.at(points[inside, :2])
    known = np.isfinite(deviation)  # beyond the middle of the outermost cells the target ends
    if not known.any():
        return None
    error = np.full(target.z.size, np.nan)
    seen = np.unique(cell[known])
    error[seen] = ndimage.median(deviation[known], cell[known], seen)
    return HeightMap(target.x, target.y, target.z + error.reshape(target.z.shape))


def points_of(message: Any) -> Array:
    """(P, 3) m, the points of which all coordinates are known.

    Raises
    ------
    IsfError : BAG_INCOMPLETE when the cloud is not of points
    """
    try:
        points = fields.cloud_columns(message)
    except ValueError as error:
        raise _unusable(f"the scan cannot be used: {error}") from error
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def _cells(axis: Array, values: Array) -> NDArray[np.intp]:
    """Index of the nearest cell of an evenly spaced ``axis``; outside of it an index that does not exist."""
    return np.rint((values - axis[0]) / (axis[1] - axis[0])).astype(np.intp)


def filled(z: Array) -> Array:
    """(ny, nx), ``z`` with unknown cells (NaN) up to :data:`REACH` beside known ones filled by the mean of those."""
    for _ in range(REACH):
        known = np.isfinite(z)
        if known.all():
            break
        count = ndimage.uniform_filter(known.astype(float), 3, mode="constant")
        total = ndimage.uniform_filter(np.where(known, z, 0.0), 3, mode="constant")
        with np.errstate(invalid="ignore", divide="ignore"):
            z = np.where(known | (count < 1e-6), z, total / count)
    return z


def _unusable(what: str) -> IsfError:
    return IsfError(
        ErrorCode.BAG_INCOMPLETE, what, where="topic scan", advice="publish points as x, y, z of float32 or float64"
    )
