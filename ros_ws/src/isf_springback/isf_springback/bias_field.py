"""A bias of the springback model along a contour, estimated from measurements with their uncertainty.

State at M places around the contour: the bias (measured minus predicted springback, positive when the sheet springs
back more than the model says) and its variance. From contour to contour the bias is carried by place and drifts as a
random walk; a measurement updates it place by place (Kalman), neighbours within the correlation length share it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

START_DEVIATION = 1.0e-3
"""m, standard deviation of the bias before anything was measured (assumed: a fifth of the springback of an unsupported
sheet, as models calibrated on one rig miss that of another)."""
DRIFT = 0.03e-3
"""m per contour, standard deviation of the change of the bias (published: the contour-to-contour change of springback
after the first contours has one of 0.03-0.05 mm, Lu 2016, 4.3.1)."""
CORRELATION = 30e-3
"""m of path over which bias is alike (assumed, as for tool lifts: a sheet bends over tens of mm; what differs within a
few mm, as the mark where contours begin, is no springback, and no correction takes it back)."""
COMMON = 0.5
"""Share of the bias's variance that is alike all around (assumed: half). Sheet and clamp are off everywhere, so that
what was measured elsewhere tells of places in the shadow of the tool."""
GATE = 4.0
"""Standard deviations beyond which a measurement counts as doubtful and is believed less."""


@dataclass(frozen=True)
class BiasField:
    """Bias at M places.

    Attributes
    ----------
    place : (M, 2) m ; bias : (M,) m ; covariance : (M, M) m^2
    """

    place: Array
    bias: Array
    covariance: Array

    @property
    def deviation(self) -> Array:
        """(M,) m, standard deviation."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)))


def first_field(place: Array) -> BiasField:
    """Nothing known at ``place`` (M, 2) m."""
    return BiasField(place, np.zeros(len(place)), START_DEVIATION**2 * _correlation(place))


def carried(field: BiasField, place: Array, contours: float = 1.0) -> BiasField:
    """``field`` at the places (M, 2) m of a later contour, after ``contours`` steps of drift."""
    weights = _weights(place, field.place)
    spread = weights @ field.covariance @ weights.T
    drift = contours * DRIFT**2 * _correlation(place)
    covariance = spread + drift
    most = START_DEVIATION**2
    scale = np.sqrt(np.minimum(1.0, most / np.maximum(np.diagonal(covariance), 1e-30)))
    return BiasField(place, weights @ field.bias, covariance * scale[:, None] * scale[None, :])


def updated(field: BiasField, measured: Array, deviation: Array) -> tuple[BiasField, NDArray[np.bool_]]:
    """``field`` after ``measured`` (M,) m (NaN: not seen) with standard deviation (M,) m; and which were doubtful.

    A doubtful one (beyond :data:`GATE` standard deviations of what was expected) is not thrown away, which would make
    the estimator blind to a true change; its deviation is widened until it lies at the gate.
    """
    seen = np.isfinite(measured)
    doubtful = np.zeros(len(measured), dtype=bool)
    if not seen.any():
        return field, doubtful
    index = np.flatnonzero(seen)
    innovation = measured[index] - field.bias[index]
    prior = field.covariance[np.ix_(index, index)]
    noise = deviation[index] ** 2
    expected = np.diagonal(prior) + noise
    excess = innovation**2 > GATE**2 * expected
    noise = np.where(excess, innovation**2 / GATE**2 - np.diagonal(prior), noise)
    doubtful[index] = excess
    gain = np.linalg.solve(prior + np.diag(noise), field.covariance[index]).T
    bias = field.bias + gain @ innovation
    covariance = field.covariance - gain @ field.covariance[index]
    return BiasField(field.place, bias, 0.5 * (covariance + covariance.T)), doubtful


def _correlation(place: Array) -> Array:
    """(M, M) correlation of the places: a part common to all, one that falls with distance, a small one of its own."""
    square = (cdist(place, place) / CORRELATION) ** 2
    near = (0.95 - COMMON) * np.exp(-0.5 * square)
    return np.asarray(COMMON + near + 0.05 * np.eye(len(place)))


def _weights(place: Array, known: Array) -> Array:
    """(M, K) interpolation weights from places ``known``: the two nearest, by inverse distance."""
    distance = cdist(place, known)
    nearest = np.argsort(distance, axis=1)[:, :2]
    rows = np.arange(len(place))[:, None]
    inverse = 1.0 / np.maximum(distance[rows, nearest], 1e-6)
    weights = np.zeros_like(distance)
    weights[rows, nearest] = inverse / inverse.sum(axis=1, keepdims=True)
    return weights
