"""The hexapod compiled, one pose after the other: strokes of a tip, and poses that have given lengths.

The formulas are those of :mod:`isf_core.geometry.hexapod` (Torrao 2013, chapter 4).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from isf_core.jit import kernel
from isf_core.types import Array, Mask

CONVERGED = 1e-12
"""m, of the cylinder lengths: Newton's method stops."""
FITS = 1e-6
"""m, of the cylinder lengths: the pose has them."""
ITERATIONS = 30
STANDS = 1e-9
"""m and rad, of a step: what it leaves is rounding, or lengths that no pose has."""


class Plates(NamedTuple):
    """Geometry of the hexapod.

    Attributes
    ----------
    base, platform : (6, 2) m, joints in their plates' planes ; straight : (6, 3) unit, along which they are straight
    sheet : (3,) m, origin of frame ``sheet`` in the base's frame ; tool_length : m ; shortest : m, of a cylinder
    """

    base: Array
    platform: Array
    straight: Array
    sheet: Array
    tool_length: float
    shortest: float


@kernel
def strokes_of(tip: Array, tilt: Array, plates: Plates, strokes: Array) -> tuple[float, float, float]:
    """Write the strokes (6,) m for the tip (3,) m in frame ``sheet`` and the tilt (2,) rad, limits not looked at.

    Returns x and y of the platform, m, and the cosine of the largest bend of a joint.
    """
    cx, sx, cy, sy = math.cos(tilt[0]), math.sin(tilt[0]), math.cos(tilt[1]), math.sin(tilt[1])
    x = tip[0] + plates.sheet[0] + plates.tool_length * sy * cx
    y = tip[1] + plates.sheet[1] - plates.tool_length * sx
    z = tip[2] + plates.sheet[2] + plates.tool_length * cy * cx
    straightest = 1.0
    for k in range(6):
        a, b = plates.platform[k, 0], plates.platform[k, 1]
        leg_x = x + cy * a + sy * sx * b - plates.base[k, 0]
        leg_y = y + cx * b - plates.base[k, 1]
        leg_z = z - sy * a + cy * sx * b
        length = math.sqrt(leg_x * leg_x + leg_y * leg_y + leg_z * leg_z)
        strokes[k] = length - plates.shortest
        along_x, along_y, along_z = plates.straight[k, 0], plates.straight[k, 1], plates.straight[k, 2]
        at_base = leg_x * along_x + leg_y * along_y + leg_z * along_z
        at_platform = (
            leg_x * (cy * along_x + sy * sx * along_y + sy * cx * along_z)
            + leg_y * (cx * along_y - sx * along_z)
            + leg_z * (cy * sx * along_y + cy * cx * along_z - sy * along_x)
        )
        straightest = min(straightest, at_base / length, at_platform / length)
    return x, y, straightest


@kernel
def find_poses(lengths: Array, plates: Plates, poses: Array, fits: Mask) -> int:
    """Newton's method from the poses (N, 5) m and rad, which it replaces, to those with the lengths (N, 6) m.

    Torrao 2013, 4.3.1, corrected: six lengths for five freedoms, so a step is that of least squares. Writes
    ``fits`` (N,), the pose has the lengths. Returns the most steps taken.
    """
    missing, slopes, normal, step = np.empty(6), np.empty((6, 5)), np.empty((5, 5)), np.empty(5)
    most = 0
    for row in range(len(poses)):
        pose = poses[row]
        used, before, moved = 0, math.inf, math.inf
        while True:
            largest = _missing_and_slopes(lengths[row], plates, pose, missing, slopes)
            fits[row] = largest < FITS
            stands = largest >= before and moved < STANDS
            if largest <= CONVERGED or not math.isfinite(largest) or stands or used == ITERATIONS:
                break
            for i in range(5):
                step[i] = 0.0
                for k in range(6):
                    step[i] += slopes[k, i] * missing[k]
                for j in range(i + 1):
                    normal[i, j] = 0.0
                    for k in range(6):
                        normal[i, j] += slopes[k, i] * slopes[k, j]
            if not _solve(normal, step):
                break
            before, moved = largest, 0.0
            for i in range(5):
                pose[i] += step[i]
                moved = max(moved, abs(step[i]))
            used += 1
        most = max(most, used)
    return most


@kernel
def _missing_and_slopes(lengths: Array, plates: Plates, pose: Array, missing: Array, slopes: Array) -> float:
    """Write what the pose (5,) misses of the lengths (6,) m, and its lengths' rates (6, 5) per rate of the pose; the
    largest that is missing, m, infinite where one is no number."""
    cx, sx, cy, sy = math.cos(pose[3]), math.sin(pose[3]), math.cos(pose[4]), math.sin(pose[4])
    largest = 0.0
    for k in range(6):
        a, b = plates.platform[k, 0], plates.platform[k, 1]
        arm_x, arm_y, arm_z = cy * a + sy * sx * b, cx * b, cy * sx * b - sy * a
        x, y, z = pose[0] + arm_x - plates.base[k, 0], pose[1] + arm_y - plates.base[k, 1], pose[2] + arm_z
        length = math.sqrt(x * x + y * y + z * z)
        missing[k] = lengths[k] - length
        if not abs(missing[k]) <= largest:
            largest = abs(missing[k]) if math.isfinite(missing[k]) else math.inf
        x, y, z = x / length, y / length, z / length
        slopes[k, 0], slopes[k, 1], slopes[k, 2] = x, y, z
        slopes[k, 3] = cy * (arm_y * z - arm_z * y) - sy * (arm_x * y - arm_y * x)
        slopes[k, 4] = arm_z * x - arm_x * z
    return largest


@kernel
def _solve(matrix: Array, right: Array) -> bool:
    """Replace ``right`` (n,) by the solution with the symmetric ``matrix`` (n, n), whose lower half is used up, by
    Cholesky's method; False where it is singular."""
    n = len(right)
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if j < i:
                matrix[i, j] = total / matrix[j, j]
            elif total > 0.0:
                matrix[i, i] = math.sqrt(total)
            else:
                return False
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]
    return True
