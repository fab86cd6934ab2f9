"""Platform on six legs, compiled: strokes of a pose, pose of the strokes, forces and inertia seen along the legs.

The formulas are those of :mod:`isf_core.geometry.hexapod` (Torrao 2013, chapter 4), for one pose at a time and with the
roll that legs of any length give the platform. A pose is (6,): the place of the platform's origin in the base's frame,
m, and the angles about x, y and z, rad.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from isf_core.geometry.hexapod import Hexapod
from isf_core.types import Array

from isf_sim.jit import kernel

GRAVITY = 9.80665
CONVERGED = 1e-11
"""m, of the leg lengths."""
ITERATIONS = 12


class Platform(NamedTuple):
    """Geometry and masses of the moving platform.

    Attributes
    ----------
    base, joints : (6, 2) m, joints in the planes of base and platform ; shortest, stroke : m ; sheet : (3,) m
    tool_length : m, platform to the centre of the tool's ball ; ball : m, its radius; the tip is its lowest point
    reach : m ; tilt : rad ; bend : cosine of the largest angle of a joint ; straight : (6, 3) unit, where it is none
    mass : kg of the plate, its radius of gyration ``gyration`` m
    spindle : kg, spindle and tool, their centre ``hanging`` m below the plate, gyration ``spindle_gyration`` m
    rod : kg of each piston with its rod
    """

    base: Array
    joints: Array
    shortest: float
    stroke: float
    sheet: Array
    tool_length: float
    ball: float
    reach: float
    tilt: float
    bend: float
    straight: Array
    mass: float
    gyration: float
    spindle: float
    hanging: float
    spindle_gyration: float
    rod: float


def platform_of(hexapod: Hexapod, ball: float, *, mass: float, gyration: float, spindle: float, rod: float) -> Platform:
    """The platform of ``hexapod``, whose tool ends in a ``ball`` of that radius (m); masses in kg. The spindle is a
    rod half as long as the tool hangs down."""
    return Platform(
        base=np.ascontiguousarray(hexapod.base, dtype=np.float64),
        joints=np.ascontiguousarray(hexapod.platform, dtype=np.float64),
        shortest=hexapod.shortest,
        stroke=hexapod.stroke,
        sheet=np.array(hexapod.sheet),
        tool_length=hexapod.tool_length - ball,
        ball=ball,
        reach=hexapod.reach,
        tilt=hexapod.tilt_limit,
        bend=math.cos(hexapod.joint_limit),
        straight=np.ascontiguousarray(hexapod.straight, dtype=np.float64),
        mass=mass,
        gyration=gyration,
        spindle=spindle,
        hanging=0.5 * hexapod.tool_length,
        spindle_gyration=0.5 * hexapod.tool_length / math.sqrt(12.0),
        rod=rod,
    )


@kernel
def turn(pose: Array, turned: Array) -> None:
    """Write Rz Ry Rx (3, 3) of the angles of ``pose``."""
    cx, sx = math.cos(pose[3]), math.sin(pose[3])
    cy, sy = math.cos(pose[4]), math.sin(pose[4])
    cz, sz = math.cos(pose[5]), math.sin(pose[5])
    turned[0, 0], turned[0, 1], turned[0, 2] = cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx
    turned[1, 0], turned[1, 1], turned[1, 2] = sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx
    turned[2, 0], turned[2, 1], turned[2, 2] = -sy, cy * sx, cy * cx


@kernel
def legs_of(pose: Array, platform: Platform, turned: Array, rates: Array, lengths: Array) -> None:
    """Write the rotation (3, 3), the lengths (6,) m and their rates per twist (6, 6), Torrao 2013, eq. 4.35."""
    turn(pose, turned)
    for k in range(6):
        x, y = platform.joints[k, 0], platform.joints[k, 1]
        ax = turned[0, 0] * x + turned[0, 1] * y
        ay = turned[1, 0] * x + turned[1, 1] * y
        az = turned[2, 0] * x + turned[2, 1] * y
        lx, ly, lz = pose[0] + ax - platform.base[k, 0], pose[1] + ay - platform.base[k, 1], pose[2] + az
        length = math.sqrt(lx * lx + ly * ly + lz * lz)
        lengths[k] = length
        ux, uy, uz = lx / length, ly / length, lz / length
        rates[k, 0], rates[k, 1], rates[k, 2] = ux, uy, uz
        rates[k, 3], rates[k, 4], rates[k, 5] = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux


@kernel
def solve(matrix: Array, right: Array) -> bool:
    """Replace ``right`` (n, m) by the solution with ``matrix`` (n, n), which is used up; False where it is singular."""
    n, columns = right.shape
    for k in range(n):
        best = k
        for row in range(k + 1, n):
            if abs(matrix[row, k]) > abs(matrix[best, k]):
                best = row
        if not abs(matrix[best, k]) > 1e-300:
            return False
        if best != k:
            for column in range(n):
                matrix[k, column], matrix[best, column] = matrix[best, column], matrix[k, column]
            for column in range(columns):
                right[k, column], right[best, column] = right[best, column], right[k, column]
        for row in range(k + 1, n):
            factor = matrix[row, k] / matrix[k, k]
            for column in range(k + 1, n):
                matrix[row, column] -= factor * matrix[k, column]
            for column in range(columns):
                right[row, column] -= factor * right[k, column]
    for k in range(n - 1, -1, -1):
        for column in range(columns):
            total = right[k, column]
            for other in range(k + 1, n):
                total -= matrix[k, other] * right[other, column]
            right[k, column] = total / matrix[k, k]
    return True


@kernel
def find_pose(lengths: Array, platform: Platform, pose: Array) -> int:
    """Newton's method from ``pose``, which it replaces, to that with the ``lengths`` (6,) m; steps, or -1 without one.

    Torrao 2013, 4.3.1, corrected: the step solves rates times twist = missing lengths.
    """
    turned, rates, found, step = np.empty((3, 3)), np.empty((6, 6)), np.empty(6), np.empty((6, 1))
    for used in range(ITERATIONS + 1):
        legs_of(pose, platform, turned, rates, found)
        largest = 0.0
        for k in range(6):
            step[k, 0] = lengths[k] - found[k]
            largest = max(largest, abs(step[k, 0]))
        if not math.isfinite(largest):
            return -1
        if largest < CONVERGED:
            return used
        if used == ITERATIONS or not solve(rates, step):
            return -1
        for k in range(3):
            pose[k] += step[k, 0]
        # angular velocity to rates of the angles: the inverse of eq. 4.40
        cy, sy, cz, sz = math.cos(pose[4]), math.sin(pose[4]), math.cos(pose[5]), math.sin(pose[5])
        about_x = (cz * step[3, 0] + sz * step[4, 0]) / cy
        pose[3] += about_x
        pose[4] += cz * step[4, 0] - sz * step[3, 0]
        pose[5] += step[5, 0] + sy * about_x
    return -1


@kernel
def place_for(tip: Array, tilt: Array, platform: Platform, pose: Array) -> None:
    """Write the pose of the platform for a tip (3,) m in frame ``sheet`` with the tilt (2,) rad, without roll.

    The tip is the lowest point of the ball, so that tilting turns the tool about the centre of the ball."""
    pose[3], pose[4], pose[5] = tilt[0], tilt[1], 0.0
    cx, sx, cy, sy = math.cos(tilt[0]), math.sin(tilt[0]), math.cos(tilt[1]), math.sin(tilt[1])
    pose[0] = tip[0] + platform.sheet[0] + platform.tool_length * sy * cx
    pose[1] = tip[1] + platform.sheet[1] - platform.tool_length * sx
    pose[2] = tip[2] + platform.ball + platform.sheet[2] + platform.tool_length * cy * cx


@kernel
def tip_at(pose: Array, turned: Array, platform: Platform, tip: Array) -> None:
    """Write the tip (3,) m in frame ``sheet`` of a pose with its rotation."""
    for k in range(3):
        tip[k] = pose[k] - platform.sheet[k] - platform.tool_length * turned[k, 2]
    tip[2] -= platform.ball


@kernel
def strokes_for(tip: Array, tilt: Array, platform: Platform, strokes: Array) -> bool:
    """Write the strokes (6,) m for a tip (3,) m and tilt (2,) rad; False where legs, joints, tilt or reach do not
    allow them (Torrao 2013, 6.2.3)."""
    pose, turned, rates, lengths = np.empty(6), np.empty((3, 3)), np.empty((6, 6)), np.empty(6)
    place_for(tip, tilt, platform, pose)
    legs_of(pose, platform, turned, rates, lengths)
    fits = max(abs(pose[0]), abs(pose[1])) <= platform.reach and max(abs(tilt[0]), abs(tilt[1])) <= platform.tilt
    for k in range(6):
        strokes[k] = lengths[k] - platform.shortest
        fits = fits and 0.0 <= strokes[k] <= platform.stroke
        at_base, at_platform = 0.0, 0.0
        for i in range(3):
            at_base += rates[k, i] * platform.straight[k, i]
            for j in range(3):
                at_platform += rates[k, i] * turned[i, j] * platform.straight[k, j]
        fits = fits and min(at_base, at_platform) >= platform.bend
    return fits


@kernel
def tip_wrench(force: Array, turned: Array, platform: Platform, wrench: Array) -> None:
    """Write the wrench (6,) N and N m at the platform's origin of ``force`` (3,) N on the tip."""
    length = platform.tool_length
    ax, ay, az = -length * turned[0, 2], -length * turned[1, 2], -length * turned[2, 2] - platform.ball
    wrench[0], wrench[1], wrench[2] = force[0], force[1], force[2]
    wrench[3] = ay * force[2] - az * force[1]
    wrench[4] = az * force[0] - ax * force[2]
    wrench[5] = ax * force[1] - ay * force[0]


@kernel
def pushes_against(wrench: Array, rates: Array, pushes: Array) -> bool:
    """Write the forces (6,) N of the legs against ``wrench`` (6,) on the platform (Torrao 2013, eq. 8.1)."""
    matrix, right = np.empty((6, 6)), np.empty((6, 1))
    for k in range(6):
        right[k, 0] = -wrench[k]
        for column in range(6):
            matrix[k, column] = rates[column, k]
    solved = solve(matrix, right)
    for k in range(6):
        pushes[k] = right[k, 0]
    return solved


@kernel
def seen_by_legs(
    turned: Array, rates: Array, wrench: Array, platform: Platform, mobility: Array, free: Array, pull: Array
) -> bool:
    """Inertia and loads of the platform as the legs see them.

    Writes ``mobility`` (6, 6) 1/kg, accelerations of the legs per force along them; ``free`` (6,) m/s^2, without any;
    ``pull`` (6,) N, weight of each rod along its leg. ``wrench`` (6,) acts on the platform beside the weights. What
    comes of the speed of the platform is left out: its legs are slower than 0.1 m/s.
    """
    mass, h = platform.mass + platform.spindle, platform.hanging
    m = platform.spindle
    arm = np.empty(3)
    for k in range(3):
        arm[k] = -h * turned[k, 2]
    inertia = np.zeros((6, 6))
    for k in range(3):
        inertia[k, k] = mass
    cross = np.zeros((3, 3))
    cross[0, 1], cross[0, 2], cross[1, 2] = -arm[2], arm[1], -arm[0]
    cross[1, 0], cross[2, 0], cross[2, 1] = arm[2], -arm[1], arm[0]
    plate, thin = platform.mass * platform.gyration**2, m * platform.spindle_gyration**2
    for i in range(3):
        for j in range(3):
            inertia[i, 3 + j] = -m * cross[i, j]
            inertia[3 + i, j] = m * cross[i, j]
            # half the polar moment of a thin plate about its diameters; a thin rod has none about its axis
            own = 0.5 * plate * ((1.0 if i == j else 0.0) + turned[i, 2] * turned[j, 2])
            own += thin * ((1.0 if i == j else 0.0) - turned[i, 2] * turned[j, 2])
            inertia[3 + i, 3 + j] = own + m * ((h * h if i == j else 0.0) - arm[i] * arm[j])
    for i in range(6):
        for j in range(6):
            for k in range(6):
                inertia[i, j] += platform.rod * rates[k, i] * rates[k, j]
    right = np.empty((6, 7))
    for i in range(6):
        right[i, 6] = wrench[i]
        for k in range(6):
            right[i, k] = rates[k, i]
    right[2, 6] -= mass * GRAVITY
    right[3, 6] -= m * GRAVITY * arm[1]
    right[4, 6] += m * GRAVITY * arm[0]
    if not solve(inertia, right):
        return False
    for i in range(6):
        pull[i] = -platform.rod * GRAVITY * rates[i, 2]
        free[i] = 0.0
        for k in range(6):
            free[i] += rates[i, k] * right[k, 6]
        for j in range(6):
            total = 0.0
            for k in range(6):
                total += rates[i, k] * right[k, j]
            mobility[i, j] = total
    return True
