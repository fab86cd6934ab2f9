"""What a part moves by when it is taken out of the clamp and trimmed: delta_3 of Ren 2018, eq. 1-1.

A part out of the clamp lies where it was put down, so that only its change of shape can be told: it is laid onto a
surface by a rigid motion before heights are compared. m, frame ``sheet``.
"""

from __future__ import annotations

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from scipy.spatial.transform import Rotation

from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.scan_cloud import filled, on_cells

_STEPS, _STILL = 30, 0.5e-6
"""Steps of the fit at most, and m by which the last of them moves a point."""
_UNTOLD = 0.03
"""Of the motion that the points tell best: what is told less, as the turn of a cone, is not made (assumed)."""


def laid_onto(points: Array, onto: HeightMap) -> Array:
    """(P, 3) m, ``points`` moved as a rigid whole so that the squares of their distances from ``onto`` are least.

    Distances are those to the tangent plane over or under a point (Chen 1992). No point is left out as an outlier:
    where springback is large it would be the part.

    Raises
    ------
    IsfError : SCAN_INCOMPLETE, hardly a point lies over ``onto``
    """
    slopes = [HeightMap(onto.x, onto.y, slope) for slope in onto.gradient()]
    for _ in range(_STEPS):
        plan = points[:, :2]
        normal = np.column_stack([*(-slope.at(plan) for slope in slopes), np.ones(len(plan))])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        error = (points[:, 2] - onto.at(plan)) * normal[:, 2]
        known = np.isfinite(error)
        if known.sum() < 100:
            raise IsfError(ErrorCode.SCAN_INCOMPLETE, f"{known.sum()} points lie over the other shape")
        middle = points[known].mean(axis=0)
        arm, square = points[known] - middle, normal[known]
        size = float(np.sqrt(np.mean(np.sum(arm**2, axis=1))))  # turns and shifts move the points alike
        matrix = np.hstack([np.cross(arm / size, square), square])
        step = np.linalg.lstsq(matrix, -error[known], rcond=_UNTOLD)[0]
        points = Rotation.from_rotvec(step[:3] / size).apply(points - middle) + middle + step[3:]
        if np.abs(matrix @ step).max() < _STILL:
            break
    return np.asarray(points)


def movement_between(scan: HeightMap, released: Array) -> HeightMap:
    """m, heights of the part out of the clamp, points ``released`` (P, 3) m that were laid onto something, over those
    of ``scan``, the part in the clamp; NaN where one of them is not known, or no point is within two cells."""
    found = on_cells(released, scan)
    return HeightMap(scan.x, scan.y, np.full(scan.z.shape, np.nan) if found is None else filled(found.z - scan.z))


def movement_of(record: PartRecord) -> HeightMap | None:
    """m, change of shape of the part of ``record`` by its release, as heights: the part out of the clamp is laid
    onto that in the clamp. None: it was not scanned in both states, or they do not fit each other."""
    if record.scan is None or record.released is None:
        return None
    try:
        return movement_between(record.scan, laid_onto(record.released, record.scan))
    except IsfError:
        return None
