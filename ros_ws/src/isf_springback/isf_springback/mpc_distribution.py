"""Horizontal springback between the directions that were optimised (Lu 2016, 3.3.2, eq. 23-30).

Scale factors beta = 1 + D / r of the radius are taken as equal (uniform), or as linear in the radius between wall
middle and corner (interpolated). With several directions, neighbours a, b bound segments; where the radius does not
change evenly between them, the angle takes its place.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from isf_core.types import Array

Distribution = Literal["none", "uniform", "interpolated", "dense"]

SMALLEST_SPAN = 0.02
"""Difference of two radii, as part of them, below which their ratio says nothing."""


def distribute(
    departure: Array, directions: Array, angle: Array, radius: Array, kind: Distribution, neutral: bool = True
) -> Array:
    """(N,) m, departures at the points of a contour.

    Parameters
    ----------
    departure : (S,) m in the ``directions`` (S,) rad
    angle, radius : (N,) rad, m, points of the contour seen from its middle
    kind : see the module; "dense" interpolates in the angle between many directions
    neutral : one direction only, interpolated: the nearest radius of all (wall middle) gets none (eq. 30)
    """
    order = np.argsort(np.mod(directions, 2 * np.pi))
    departure, directions = departure[order], np.mod(directions, 2 * np.pi)[order]
    here = np.mod(angle, 2 * np.pi)
    if kind == "none":
        return np.zeros(len(angle))
    if kind == "dense":
        return np.asarray(np.interp(here, directions, departure, period=2 * np.pi))
    by_angle = np.argsort(here)
    at = np.interp(directions, here[by_angle], radius[by_angle], period=2 * np.pi)
    if kind == "uniform":
        scale = np.interp(here, directions, departure / at, period=2 * np.pi)
        return np.asarray(radius * scale)
    if len(departure) == 1:
        least = float(radius.min())
        span = float(at[0]) - least
        if not neutral or span < SMALLEST_SPAN * least:
            return np.asarray(departure[0] * radius / at[0])
        return np.asarray(departure[0] * radius * (radius - least) / (at[0] * span))
    return _between(departure / at, directions, at, here, radius)


def _between(factor: Array, directions: Array, at: Array, here: Array, radius: Array) -> Array:
    """Departures (N,) from beta - 1 = ``factor`` (S,) at several directions, segment by segment."""
    count = len(directions)
    segment = np.searchsorted(directions, here, side="right") - 1
    a, b = segment % count, (segment + 1) % count
    way = np.mod(directions[b] - directions[a], 2 * np.pi)
    by_angle = np.mod(here - directions[a], 2 * np.pi) / np.where(way > 0, way, 2 * np.pi)
    span = at[b] - at[a]
    usable = np.abs(span) > SMALLEST_SPAN * at[a]
    ratio = (radius - at[a]) / np.where(usable, span, 1.0)
    share = np.where(usable & (ratio >= 0.0) & (ratio <= 1.0), ratio, by_angle)
    return np.asarray(radius * (factor[a] + share * (factor[b] - factor[a])))
