"""Control points: where the coarse shell was solved, and the local law of sheet deflection between them.

Near a control point the sheet at the tool moves by u(F) = u_k (F / F_k)^b with b = C_zz F_k / S_k; laws of nearby
points are blended with Gaussian weights.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from isf_sim.jit import kernel

Array = NDArray[np.float64]

CAPACITY = 64


class ControlPoints(NamedTuple):
    """Newest solutions, CAPACITY rows of which ``used[0]`` are in use.

    Attributes
    ----------
    place : (K, 3) m, commanded tip ; displacement : (K, 3) m ; force : (K,) N, axial ; exponent : (K,) b
    """

    used: NDArray[np.int64]
    place: Array
    displacement: Array
    force: Array
    exponent: Array


def no_control_points() -> ControlPoints:
    """None yet."""
    return ControlPoints(
        used=np.zeros(1, dtype=np.int64),
        place=np.zeros((CAPACITY, 3)),
        displacement=np.zeros((CAPACITY, 3)),
        force=np.ones(CAPACITY),
        exponent=np.ones(CAPACITY),
    )


@kernel
def is_fresh(points: ControlPoints, x: float, y: float, z: float, depth: float, distance: float) -> bool:
    """True when a control point lies within ``depth`` m in z and ``distance`` m in the plane."""
    for k in range(points.used[0]):
        place = points.place[k]
        if abs(place[2] - z) < depth and (place[0] - x) ** 2 + (place[1] - y) ** 2 < distance**2:
            return True
    return False


@kernel
def blend(points: ControlPoints, x: float, y: float, force: float, length: float, out: Array) -> float:
    """Displacement out (3,) m at ``force`` N and the exponent there, weights exp(-(r / length)^2)."""
    total = exponent = 0.0
    out[:] = 0.0
    for k in range(points.used[0]):
        square = ((points.place[k, 0] - x) ** 2 + (points.place[k, 1] - y) ** 2) / length**2
        if square > 16.0:
            continue
        weight = math.exp(-square) + 1e-12
        share = weight * (force / points.force[k]) ** points.exponent[k]
        total += weight
        exponent += weight * points.exponent[k]
        for m in range(3):
            out[m] += share * points.displacement[k, m]
    if total <= 0.0:
        return 0.5
    for m in range(3):
        out[m] /= total
    return exponent / total
