"""Control points: where the coarse shell was solved, and the local law of sheet deflection between them.

Near a control point the sheet at the tool moves by u(F) = u_k (F / F_k)^b with b = C_zz F_k / S_k; laws of nearby
points are blended with Gaussian weights.

A solution is begun where no control point is near enough any more, and taken over LEAD of path later (earlier only when
the law of the old points reaches no further), whenever it was ready: the same with and without a worker.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel

CAPACITY = 64
LEAD = 3.0e-3
"""m, way of the tool between the beginning of a solution and its use: 0.1 s at 30 mm/s."""
APPROACH = 3.0e-3
"""m, height over the sheet at which the first solution is begun."""
REACH = 1.6
"""Distance to which the law of old points serves while a solution is under way, over that at which it is begun."""

OFF_TIES = 1.0e-6
"""m, what every bound of distance is short of its round value: steps of a path are round too, and at a tie the last bit
would decide which solutions there are."""

NOTHING, BEGIN, TAKE = 0, 1, 2
"""What :func:`coarse_request` asks for."""

UNDER_WAY, DUE, HEIGHT = 0, 1, 2
"""Places in ControlPoints.pending."""


class ControlPoints(NamedTuple):
    """Newest solutions, CAPACITY rows of which ``used[0]`` are in use.

    Attributes
    ----------
    place : (K, 3) m, commanded tip ; displacement : (K, 3) m ; force : (K,) N, axial ; exponent : (K,) b
    pending : (3,) 1 while a solution is under way, m path at which it is used, m height of its place
    """

    used: NDArray[np.int64]
    place: Array
    displacement: Array
    force: Array
    exponent: Array
    pending: Array


def no_control_points() -> ControlPoints:
    """None yet."""
    return ControlPoints(
        used=np.zeros(1, dtype=np.int64),
        place=np.zeros((CAPACITY, 3)),
        displacement=np.zeros((CAPACITY, 3)),
        force=np.ones(CAPACITY),
        exponent=np.ones(CAPACITY),
        pending=np.zeros(3),
    )


@kernel
def coarse_request(
    points: ControlPoints, x: float, y: float, z: float, path: float, depth: float, distance: float
) -> int:
    """What the tool at (x, y, z) m after ``path`` m needs: NOTHING, BEGIN a solution, TAKE the one under way over.

    ``depth``, ``distance`` m : see :func:`is_fresh`
    """
    if points.pending[UNDER_WAY] > 0.0:
        if path < points.pending[DUE] and is_fresh(points, x, y, z, REACH * depth, REACH * distance):
            return NOTHING
        return TAKE
    if is_fresh(points, x, y, z, depth, distance):
        return NOTHING
    points.pending[HEIGHT] = z
    return BEGIN


@kernel
def is_fresh(points: ControlPoints, x: float, y: float, z: float, depth: float, distance: float) -> bool:
    """True when a control point lies within ``depth`` m in z and ``distance`` m in the plane."""
    depth, distance = depth - OFF_TIES, distance - OFF_TIES
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


@kernel
def nearest_point(points: ControlPoints, tip: Array) -> tuple[int, float]:
    """Number of the control point nearest to ``tip`` (3,) m, depth counting threefold, and the square of its distance;
    negative where there is none."""
    nearest, least = -1, math.inf
    for k in range(points.used[0]):
        dx, dy = points.place[k, 0] - tip[0], points.place[k, 1] - tip[1]
        dz = (points.place[k, 2] - tip[2]) * 3.0
        square = dx * dx + dy * dy + dz * dz
        if square < least:
            nearest, least = k, square
    return nearest, least


@kernel
def add_point(
    points: ControlPoints,
    place: Array,
    force: float,
    displacement: Array,
    compliance: float,
    give: float,
    near: float,
    tall: float,
    chosen: NDArray[np.int64],
) -> int:
    """Add a control point at ``place`` (3,) m; older ones close by, or far above or below, are dropped.

    Parameters
    ----------
    force : N, axial ; displacement : (3,) m ; compliance : m/N ; give : m/N, of the sheet below the coarse grid's scale
    near : m^2, square of the distance in the plane within which a point is dropped ; tall : m, in z beyond which it is
    chosen : (CAPACITY,) numbers of the points that are kept, result

    Returns
    -------
    how many are kept
    """
    n = 0
    for k in range(points.used[0]):
        dx, dy, dz = points.place[k, 0] - place[0], points.place[k, 1] - place[1], points.place[k, 2] - place[2]
        if dx * dx + dy * dy > near and abs(dz) < tall:
            chosen[n] = k
            n += 1
    if n > CAPACITY - 1:  # the oldest ones go
        for k in range(CAPACITY - 1):
            chosen[k] = chosen[k + n - CAPACITY + 1]
        n = CAPACITY - 1
    for k in range(n):
        old = chosen[k]
        for m in range(3):
            points.place[k, m] = points.place[old, m]
            points.displacement[k, m] = points.displacement[old, m]
        points.force[k], points.exponent[k] = points.force[old], points.exponent[old]
    for m in range(3):
        points.place[n, m], points.displacement[n, m] = place[m], displacement[m]
    points.displacement[n, 2] -= give * force
    points.force[n] = force
    sag = max(-points.displacement[n, 2], 1e-9)
    points.exponent[n] = min(max((compliance + give) * force / sag, 0.3), 1.0)
    points.used[0] = n + 1
    return n
