"""Points of a scan: what makes them unusable at sight, and their heights on a grid without outliers."""

from __future__ import annotations

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from scipy import ndimage

FEWEST_POINTS = 500
SMALLEST_FINITE = 0.2
"""Share of the points that must be finite."""
SMALLEST_EXTENT, LARGEST_EXTENT = 0.2, 5.0
"""Extent of the points over the size of the clamp: beyond, the unit is wrong (mm for m is a factor of 1000)."""
OUTLIER_FLOOR = 0.4e-3
"""m, smaller departures from the median of the neighbours are never outliers (eight times the published scanner
accuracy of 0.05 mm, Lu 2016, 3.5.2)."""
OUTLIER_FACTOR = 6.0
"""Robust standard deviations beyond which a point is an outlier."""
WINDOW = 5
"""Nodes of the median around a node."""
SMALLEST_WEIGHT = 0.05
"""Sum of the bilinear weights below which a node counts as not seen."""


def checked_points(points: Array, clamp: tuple[float, float], part: tuple[float, float] | None = None) -> Array:
    """(Q, 3) m, the finite points of ``points`` (P, 3) over a clamp of ``clamp`` m x m, or of a part out of it that is
    ``part`` m x m at least.

    Raises
    ------
    IsfError : SCAN_NOT_FINITE, SCAN_UNIT_SUSPECT, SCAN_INCOMPLETE (hardly any points)
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < FEWEST_POINTS:
        raise IsfError(
            ErrorCode.SCAN_INCOMPLETE,
            f"the scan has the shape {points.shape}; {FEWEST_POINTS} points or more are needed",
            where="scan",
            advice="check the field of view of the scanner",
        )
    finite = np.isfinite(points).all(axis=1)
    if finite.mean() < SMALLEST_FINITE:
        raise IsfError(
            ErrorCode.SCAN_NOT_FINITE,
            f"{100 * (1 - finite.mean()):.0f} % of {len(points)} points are not finite",
            where="scan",
            advice="check the scanner; glossy sheet may need a matt spray",
        )
    points = points[finite]
    extent = np.percentile(points[:, :2], 98, axis=0) - np.percentile(points[:, :2], 2, axis=0)
    most, least = (float(np.max(extent / np.asarray(size))) for size in (clamp, part or clamp))
    if least < SMALLEST_EXTENT or most > LARGEST_EXTENT:
        raise IsfError(
            ErrorCode.SCAN_UNIT_SUSPECT,
            f"the points span {extent[0]:.4g} x {extent[1]:.4g} m, the clamp {clamp[0]:.4g} x {clamp[1]:.4g} m",
            where="scan",
            advice="coordinates must be in metres",
        )
    return points


def grid_heights(points: Array, clamp: tuple[float, float], pitch: float) -> tuple[HeightMap, int]:
    """Heights at nodes of ``pitch`` m over the clamp (NaN where no point is near), and the number of outliers.

    A point counts for the four nodes around it by bilinear weights; its height is taken there with the slope of the
    neighbourhood, so that uneven points on a wall do not shift it. Outliers are points that depart from the median of
    the nodes around by more than :data:`OUTLIER_FACTOR` robust standard deviations.
    """
    half = [int(np.floor(0.5 * side / pitch + 1e-9)) for side in clamp]
    x, y = (pitch * np.arange(-n, n + 1, dtype=np.float64) for n in half)
    shape = (len(y), len(x))
    column, row = points[:, 0] / pitch + half[0], points[:, 1] / pitch + half[1]
    inside = (column >= 0) & (column <= len(x) - 1) & (row >= 0) & (row <= len(y) - 1)
    column, row, z = column[inside], row[inside], points[inside, 2]
    rough = _spread(column, row, z, None, shape)
    smooth = _filled_median(rough)
    slopes = list(np.gradient(smooth))
    near_row, near_column = np.rint(row).astype(np.int64), np.rint(column).astype(np.int64)
    expected = (
        smooth[near_row, near_column]
        + slopes[0][near_row, near_column] * (row - near_row)
        + slopes[1][near_row, near_column] * (column - near_column)
    )
    departure = np.abs(z - expected)
    spread = 1.4826 * float(np.median(departure)) if len(departure) else 0.0
    good = departure <= max(OUTLIER_FLOOR, OUTLIER_FACTOR * spread)
    return HeightMap(x, y, _spread(column[good], row[good], z[good], slopes, shape)), int((~good).sum())


def _spread(column: Array, row: Array, z: Array, slopes: list[Array] | None, shape: tuple[int, int]) -> Array:
    """Weighted mean of the points around every node; coordinates in cells, ``slopes`` (row, column) in m per cell."""
    first_row = np.minimum(np.floor(row).astype(np.int64), shape[0] - 2)
    first_column = np.minimum(np.floor(column).astype(np.int64), shape[1] - 2)
    total, weight = np.zeros(shape[0] * shape[1]), np.zeros(shape[0] * shape[1])
    for down in (0, 1):
        for right in (0, 1):
            at_row, at_column = first_row + down, first_column + right
            away_row, away_column = at_row - row, at_column - column
            share = (1.0 - np.abs(away_row)) * (1.0 - np.abs(away_column))
            height = z
            if slopes is not None:
                height = z + slopes[0][at_row, at_column] * away_row + slopes[1][at_row, at_column] * away_column
            cell = at_row * shape[1] + at_column
            total += np.bincount(cell, weights=share * height, minlength=len(total))
            weight += np.bincount(cell, weights=share, minlength=len(weight))
    mean = np.full(len(total), np.nan)
    near = weight > SMALLEST_WEIGHT
    mean[near] = total[near] / weight[near]
    return mean.reshape(shape)


def _filled_median(z: Array) -> Array:
    """Median over the nodes around, holes filled from the nearest known node."""
    if np.isnan(z).any():
        nearest = ndimage.distance_transform_edt(np.isnan(z), return_distances=False, return_indices=True)
        z = z[tuple(nearest)]
    return np.asarray(ndimage.median_filter(z, size=WINDOW, mode="nearest"))
