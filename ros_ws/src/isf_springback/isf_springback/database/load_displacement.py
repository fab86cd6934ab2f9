"""Load and displacement of a control point: computed samples, and laws through them.

Two laws: the published power law S = a F^b (Ren 2018 eq. 4-7), kept for comparison and exchange, and
F = k1 S + k2 S^2 + k3 S^3 (plate bending, transition, membrane), which follows the samples about ten times closer and
is used for corrections. Forces in N, displacements in m, both positive along the push.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from scipy.optimize import nnls

_BISECTIONS = 48


@dataclass(frozen=True)
class PowerLaw:
    """S = a F^b for M points: ``a`` (M,) m/N^b, ``b`` (M,), ``r_squared`` (M,) of the displacements."""

    a: Array
    b: Array
    r_squared: Array

    def displacement(self, force: Array) -> Array:
        """(M,) m, under ``force`` (M,) N."""
        return np.asarray(self.a * np.maximum(force, 0.0) ** self.b)


@dataclass(frozen=True)
class CubicLaw:
    """F = k1 S + k2 S^2 + k3 S^3 for M points: ``k`` (M, 3) N/m, N/m^2, N/m^3; rises with S everywhere."""

    k: Array

    def force(self, displacement: Array) -> Array:
        """(M,) N, for ``displacement`` (M,) m."""
        s = displacement
        return np.asarray(((self.k[:, 2] * s + self.k[:, 1]) * s + self.k[:, 0]) * s)

    def stiffness(self, displacement: Array) -> Array:
        """(M,) N/m, dF/dS at ``displacement`` (M,) m."""
        s = displacement
        return np.asarray((3.0 * self.k[:, 2] * s + 2.0 * self.k[:, 1]) * s + self.k[:, 0])

    def displacement(self, force: Array) -> Array:
        """(M,) m, the one root for ``force`` (M,) N; zero for pulls."""
        wanted = np.maximum(force, 0.0)
        low, high = np.zeros_like(wanted), np.full_like(wanted, 1e-6)
        for _ in range(24):
            short = self.force(high) < wanted
            if not short.any():
                break
            high = np.where(short, 2.0 * high, high)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            above = self.force(middle) > wanted
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return np.asarray(np.where(wanted > 0.0, 0.5 * (low + high), 0.0))


def power_law(load: Array, displacement: Array) -> PowerLaw:
    """Law through samples: ``load`` (L,) N, ``displacement`` (M, L) m; least squares of ln S on ln F.

    Raises
    ------
    IsfError : DATABASE_UNUSABLE, samples that do not rise from zero
    """
    _check(load, displacement)
    x, y = np.log(load), np.log(displacement)
    dx = x - x.mean()
    b = (y - y.mean(axis=1, keepdims=True)) @ dx / (dx @ dx)
    a = np.exp(y.mean(axis=1) - b * x.mean())
    fitted = a[:, None] * load[None] ** b[:, None]
    spread = ((displacement - displacement.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    r_squared = 1.0 - ((displacement - fitted) ** 2).sum(axis=1) / np.maximum(spread, 1e-30)
    return PowerLaw(a, b, r_squared)


def cubic_law(load: Array, displacement: Array) -> CubicLaw:
    """Law through samples: ``load`` (L,) N, ``displacement`` (M, L) m; relative least squares of the force.

    A fit that would fall somewhere is made again with coefficients that are not negative, so that every force has one
    displacement, also beyond the samples.

    Raises
    ------
    IsfError : DATABASE_UNUSABLE, samples that do not rise from zero
    """
    _check(load, displacement)
    k = np.empty((len(displacement), 3))
    for m, s in enumerate(displacement):
        unit = float(s[-1])
        rows = np.stack([(s / unit) ** p for p in (1, 2, 3)], axis=1) / load[:, None]
        fit = np.linalg.lstsq(rows, np.ones(len(load)), rcond=None)[0]
        # the slope k1 + 2 k2 s + 3 k3 s^2 is positive for every s >= 0
        rises = fit[0] > 0.0 and fit[2] >= 0.0 and fit[1] > -np.sqrt(3.0 * max(fit[0] * fit[2], 0.0))
        if not rises:
            fit = nnls(rows, np.ones(len(load)))[0]
        k[m] = fit / unit ** np.array([1.0, 2.0, 3.0])
    return CubicLaw(k)


def _check(load: Array, displacement: Array) -> None:
    samples = np.column_stack([np.zeros(len(displacement)), displacement])
    rising = bool(np.isfinite(displacement).all() and (np.diff(samples, axis=1) > 0.0).all())
    if not rising or not (np.diff(np.concatenate([[0.0], load])) > 0.0).all():
        raise IsfError(
            ErrorCode.DATABASE_UNUSABLE,
            "loads and displacements must increase from zero",
            where="load-displacement samples",
            advice="compute the database again",
        )
