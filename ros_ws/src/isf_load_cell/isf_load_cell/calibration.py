"""Calibration of a load cell from known loads: a matrix for all channels at once, or a gain for each channel.

The matrix M turns readings after tare into forces, F = M (u - u_0); rows of both are known loads, so M is a linear
least-squares fit. Per channel it is a straight line through loads of both signs (Torrao 2013, section 3.4.2). Data of
such tests hold slips of sign and of decimal point; they are found by their residuals against a robust fit and told, not
silently used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.optimize import least_squares

OUTLIER = 6.0
"""Robust standard deviations from which a reading is an outlier."""

MINIMUM_SCALE = 2.0e-3
"""Least standard deviation as a share of the largest load: cells are linear to some 0.5 %, that is no slip."""


@dataclass(frozen=True)
class MatrixCalibration:
    """Fit of n loads, C channels of the cell, A components of the load.

    Attributes
    ----------
    matrix : (A, C) N (or N m) per unit of the readings
    zero : (C,) readings without load
    residual : (n, A) N, load less what the fit says
    uncertainty : (A, C) standard deviation of the matrix
    rejected : (n,) bool, outliers that took no part
    """

    matrix: Array
    zero: Array
    residual: Array
    uncertainty: Array
    rejected: NDArray[np.bool_]

    def force(self, reading: Array) -> Array:
        """(..., A) force of ``reading`` (..., C)."""
        return (np.asarray(reading) - self.zero) @ self.matrix.T


@dataclass(frozen=True)
class ChannelCalibration:
    """Straight line load = gain * reading + offset: ``gain`` N per unit, ``offset`` N, ``r_squared``, ``residual`` (n,)
    N, ``rejected`` (n,) bool."""

    gain: float
    offset: float
    r_squared: float
    residual: Array
    rejected: NDArray[np.bool_]


def fit_matrix(load: Array, reading: Array) -> MatrixCalibration:
    """Matrix from known ``load`` (n, A) N and ``reading`` (n, C); rows without load give the zero if there are any.

    Raises IsfError FILE_FIELD when the loads do not determine the matrix.
    """
    load, reading = _finite(load), _finite(reading)
    if len(load) != len(reading):
        raise IsfError(ErrorCode.FILE_FIELD, f"{len(load)} loads, but {len(reading)} readings")
    free = ~load.any(axis=1)
    with_one = np.column_stack([reading, np.ones(len(reading))])
    columns = with_one.shape[1]
    if len(load) < columns + 1 or np.linalg.matrix_rank(with_one) < columns:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"{len(load)} loads do not determine {columns - 1} channels",
            advice="load the cell along every axis, with both signs, and once without load",
        )
    keep = np.ones(len(load), dtype=bool)
    for _ in range(10):
        solution = np.linalg.lstsq(with_one[keep], load[keep], rcond=None)[0]
        residual = load - with_one @ solution
        size = np.linalg.norm(residual, axis=1)
        scale = max(1.4826 * float(np.median(size)), MINIMUM_SCALE * float(np.abs(load).max()))
        found = size <= OUTLIER * scale
        if found.sum() <= columns or (found == keep).all():
            break
        keep = found
    matrix: Array = np.asarray(solution[:-1].T, dtype=np.float64)
    constant = solution[-1]
    # F = M u + c = M (u - u_0): without load the readings are u_0; of channels no load case shows, the least-norm one
    zero = reading[free & keep].mean(axis=0) if (free & keep).any() else -np.linalg.pinv(matrix) @ constant
    residual = load - (reading - zero) @ matrix.T
    freedom = max(1, int(keep.sum()) - columns)
    variance = (residual[keep] ** 2).sum(axis=0) / freedom
    inverse = np.linalg.inv(with_one[keep].T @ with_one[keep])
    uncertainty = np.sqrt(np.outer(variance, np.diag(inverse)[:-1]))
    return MatrixCalibration(matrix, zero, residual, uncertainty, ~keep)


def fit_channel(
    load: Array, reading: Array, *, largest: float | None = None, robust: bool = True
) -> ChannelCalibration:
    """Straight line through ``load`` (n,) N over ``reading`` (n,), loads of both signs.

    ``largest`` N leaves out greater loads, ``robust`` finds outliers (else plain least squares, as in the source).
    Raises IsfError FILE_FIELD when there are fewer than three different loads.
    """
    load, reading = _finite(load), _finite(reading)
    keep = np.ones(len(load), dtype=bool) if largest is None else np.abs(load) <= largest
    if len(load) != len(reading) or len(np.unique(load[keep])) < 3 or np.ptp(reading[keep]) == 0.0:
        raise IsfError(ErrorCode.FILE_FIELD, "a channel needs readings at three different loads or more")
    if robust:
        start = np.polyfit(reading[keep], load[keep], 1)

        def error(line: Array) -> Array:
            return np.asarray(line[0] * reading[keep] + line[1] - load[keep])

        scale = max(1.4826 * float(np.median(np.abs(error(start)))), 1e-6 * float(np.abs(load).max()))
        line = least_squares(error, start, loss="soft_l1", f_scale=scale).x
        far = np.abs(line[0] * reading + line[1] - load)
        spread = max(1.4826 * float(np.median(far[keep])), 1e-6 * float(np.abs(load).max()))
        # what is off by far less than the load itself is the cell's own non-linearity, not a slip
        keep &= ~((far > OUTLIER * spread) & (far > 0.2 * np.abs(load)))
    gain, offset = np.polyfit(reading[keep], load[keep], 1)
    residual = load - (gain * reading + offset)
    total = float(((load[keep] - load[keep].mean()) ** 2).sum())
    return ChannelCalibration(
        float(gain), float(offset), 1.0 - float((residual[keep] ** 2).sum()) / total, residual, ~keep
    )


def _finite(values: Array) -> Array:
    values = np.asarray(values, dtype=float)
    if not np.isfinite(values).all():
        raise IsfError(ErrorCode.FILE_FIELD, "loads and readings must be finite numbers")
    return values
