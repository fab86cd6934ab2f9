"""What scans between contours say against what was expected of them: a bias around the contour, and its uncertainty.

The state stands at M places around the contour: the bias (measured minus expected error, positive when the sheet
springs back more than was expected) and its covariance. From contour to contour it is carried by place and drifts as a
random walk; a measurement updates it place by place (Kalman), neighbours within the correlation length share it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from isf_springback.loop_path import nearest_points

LARGEST_BIAS = 3e-3
"""m; the shape may ask for that much more than was expected and no more (assumed: more than half of all published
springback)."""
REPORTED_BIAS = 1.5e-3
"""m of disagreement of expectation and shape that is reported."""
DRIFT_AFTER_SURPRISE = 40.0
"""Contours of drift after a scan that surprised everywhere (assumed): a surprise that comes again is a change of the
process, and is then followed within two scans."""
DOUBTFUL_SHARE = 0.25
"""Share of doubtful places from which a scan contradicts what was expected."""
DEEPER = 0.2e-3
"""m of more push than on the contour before, beyond which a contour wipes out the traces of that one."""


@dataclass(frozen=True)
class ModelledContour:
    """One contour of N points: how it was pushed, and what the model says of it, with the force measured on it once
    that is known; (N,) m each."""

    contour: Contour
    pushed: Array
    model: Array


def expected_error(steps: Sequence[ModelledContour], place: Array) -> Array:
    """(M,) m, error of the wall at ``place`` (M, 2) m by the model alone: mean over the contours that made it.

    A contour that went deeper than the one before it by more than :data:`DEEPER` is the first that counts.
    """
    total, count, counts = np.zeros(len(place)), np.zeros(len(place)), np.ones(len(place))
    later: Array | None = None
    for step in reversed(steps):
        near = nearest_points(place, step.contour.forming_tip[:, :2])
        pushed, model = step.pushed[near], step.model[near]
        if later is not None:
            counts = np.where(later > pushed + DEEPER, 0.0, counts)
        total += counts * (model - pushed)
        count += counts
        later = pushed
    return np.asarray(total / count)


def same_wall(known: Contour, contour: Contour) -> bool:
    """True when both contours belong to one feature, stage and forming tool of one plan."""
    return (known.plan_id, known.feature, known.stage, known.forming_tool) == (
        contour.plan_id,
        contour.feature,
        contour.stage,
        contour.forming_tool,
    )


def floor_share(contour: Contour, target: HeightMap, radius: float) -> Array:
    """(N,) 0 on the wall .. 1 where ``contour``, of a ball of ``radius`` m, makes the floor of ``target``."""
    remaining = np.abs(contour.forming_tip[:, 2] - float(np.nanmin(target.z)))
    height = radius * (1.0 - np.cos(np.radians(50.0)))
    return np.asarray(np.clip(1.0 - remaining / height, 0.0, 1.0))


DRIFT = 0.03e-3
"""m per contour, standard deviation of the change of the bias (published: the contour-to-contour change of springback
after the first contours has one of 0.03-0.05 mm, Lu 2016, 4.3.1)."""
CORRELATION = 30e-3
"""m of path over which bias is alike (assumed, as for tool lifts: a sheet bends over tens of mm; what differs within a
few mm, as the mark where contours begin, is no springback, and no correction takes it back)."""
STEEPEST = np.radians(75.0)
"""Of a wall, as far as a shift in plan shows in its height."""
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


@dataclass(frozen=True)
class Prior:
    """What is known of a bias before anything was measured.

    Attributes
    ----------
    deviation : m, standard deviation
    common : share of the variance that is alike all around, so that what was measured elsewhere tells of places in the
        shadow of the tool
    shift : m, standard deviation in x and in y of where the part lies in plan, which makes a wall too deep on one side
        and the opposite one too high; beside ``deviation``
    """

    deviation: float
    common: float
    shift: float = 0.0


OF_A_MODEL = Prior(1.0e-3, 0.5)
"""Of measured minus modelled springback (assumed: a fifth of the springback of an unsupported sheet, as models
calibrated on one rig miss that of another; half of it, by sheet and clamp, everywhere)."""


def first_field(place: Array, prior: Prior = OF_A_MODEL, lever: Array | None = None) -> BiasField:
    """Nothing measured yet at ``place`` (M, 2) m; ``lever`` (M, 2) of :func:`shift_lever`, None: nothing is shifted."""
    return BiasField(place, np.zeros(len(place)), _covariance(place, prior, lever))


def carried(
    field: BiasField,
    place: Array,
    contours: float = 1.0,
    prior: Prior = OF_A_MODEL,
    lever: Array | None = None,
) -> BiasField:
    """``field`` at the places (M, 2) m of a later contour, after ``contours`` steps of drift; no more uncertain than
    :func:`first_field` there."""
    weights = _weights(place, field.place)
    spread = weights @ field.covariance @ weights.T
    drift = contours * DRIFT**2 * _correlation(place, prior.common)
    covariance = spread + drift
    most = np.diagonal(_covariance(place, prior, lever))
    scale = np.sqrt(np.minimum(1.0, most / np.maximum(np.diagonal(covariance), 1e-30)))
    return BiasField(place, weights @ field.bias, covariance * scale[:, None] * scale[None, :])


def shift_lever(contour: Contour, place: Array) -> Array:
    """(M, 2) height of the wall at ``place`` (M, 2) m of ``contour`` per way by which the part lies off in plan.

    The wall rises outwards: a part that lies off in that direction has it too deep there, and too high on the other
    side.
    """
    near = nearest_points(place, contour.contact[:, :2])
    outwards = (contour.contact - contour.forming_tip)[near, :2]
    size = np.linalg.norm(outwards, axis=1, keepdims=True)
    slope = np.tan(np.minimum(contour.wall_angle[near], STEEPEST))
    return np.asarray(-slope[:, None] * outwards / np.maximum(size, 1e-9))


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


def _covariance(place: Array, prior: Prior, lever: Array | None) -> Array:
    """(M, M) m^2, of a bias of which nothing was measured."""
    covariance = prior.deviation**2 * _correlation(place, prior.common)
    return covariance if lever is None else covariance + prior.shift**2 * lever @ lever.T


def _correlation(place: Array, common: float) -> Array:
    """(M, M) correlation of the places: a part common to all, one that falls with distance, a small one of its own."""
    square = (cdist(place, place) / CORRELATION) ** 2
    near = (0.95 - common) * np.exp(-0.5 * square)
    return np.asarray(common + near + 0.05 * np.eye(len(place)))


def _weights(place: Array, known: Array) -> Array:
    """(M, K) interpolation weights from places ``known``: the two nearest, by inverse distance."""
    distance = cdist(place, known)
    nearest = np.argsort(distance, axis=1)[:, :2]
    rows = np.arange(len(place))[:, None]
    inverse = 1.0 / np.maximum(distance[rows, nearest], 1e-6)
    weights = np.zeros_like(distance)
    weights[rows, nearest] = inverse / inverse.sum(axis=1, keepdims=True)
    return weights
