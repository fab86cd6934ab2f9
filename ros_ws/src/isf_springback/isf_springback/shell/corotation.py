"""Large rotations, small strains: energy, internal force and tangent of all facets in their moving frames.

Nodes have a position X + U and a rotation matrix R. Each facet's frame follows its three nodes: e1 along side 1-2,
e3 normal. Its deformational freedoms are the changes of l, x_3, y_3 and the nodal rotation vectors
theta_a = log(E R_a E0') left over in that frame (E, E0: frames now and at rest). The energy is
1/2 d_m' K_m d_m + 1/2 d_b' K_b d_b and the internal force its exact gradient by translations and spins. The tangent is
the consistent one of the element-independent corotational form (Nour-Omid and Rankin 1991) without the derivative of
the logarithm's Jacobian, symmetrised: it steers iterations only, never the result.
"""

from __future__ import annotations

import math

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.shell.jit import kernel


@kernel
def _moving_frame(p: Array, frame: Array) -> tuple[float, float, float]:
    """Fill ``frame`` (3, 3) from three positions (3, 3) m; returns l, x_3, y_3."""
    ax, ay, az = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
    bx, by, bz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
    length = math.sqrt(ax * ax + ay * ay + az * az)
    frame[0, 0], frame[0, 1], frame[0, 2] = ax / length, ay / length, az / length
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    norm = math.sqrt(nx * nx + ny * ny + nz * nz)
    frame[2, 0], frame[2, 1], frame[2, 2] = nx / norm, ny / norm, nz / norm
    frame[1, 0] = frame[2, 1] * frame[0, 2] - frame[2, 2] * frame[0, 1]
    frame[1, 1] = frame[2, 2] * frame[0, 0] - frame[2, 0] * frame[0, 2]
    frame[1, 2] = frame[2, 0] * frame[0, 1] - frame[2, 1] * frame[0, 0]
    x3 = bx * frame[0, 0] + by * frame[0, 1] + bz * frame[0, 2]
    y3 = bx * frame[1, 0] + by * frame[1, 1] + bz * frame[1, 2]
    return length, x3, y3


@kernel
def _logarithm(q: Array, theta: Array, jacobian: Array) -> None:
    """Rotation vector of the matrix ``q`` (3, 3) and the derivative of the vector by a spin on the left."""
    a0, a1, a2 = 0.5 * (q[2, 1] - q[1, 2]), 0.5 * (q[0, 2] - q[2, 0]), 0.5 * (q[1, 0] - q[0, 1])
    sine = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    if sine > 1e-4:
        angle = math.atan2(sine, 0.5 * (q[0, 0] + q[1, 1] + q[2, 2] - 1.0))
        factor = angle / sine
    else:
        factor = 1.0 + sine * sine / 6.0
        angle = sine * factor
    t0, t1, t2 = a0 * factor, a1 * factor, a2 * factor
    theta[0], theta[1], theta[2] = t0, t1, t2
    square = t0 * t0 + t1 * t1 + t2 * t2
    if angle > 1e-2:
        eta = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / square
    else:
        eta = 1.0 / 12.0 + square / 720.0
    jacobian[0, 0] = 1.0 + eta * (t0 * t0 - square)
    jacobian[1, 1] = 1.0 + eta * (t1 * t1 - square)
    jacobian[2, 2] = 1.0 + eta * (t2 * t2 - square)
    jacobian[0, 1], jacobian[1, 0] = eta * t0 * t1 + 0.5 * t2, eta * t0 * t1 - 0.5 * t2
    jacobian[0, 2], jacobian[2, 0] = eta * t0 * t2 - 0.5 * t1, eta * t0 * t2 + 0.5 * t1
    jacobian[1, 2], jacobian[2, 1] = eta * t1 * t2 + 0.5 * t0, eta * t1 * t2 - 0.5 * t0


@kernel
def _relative_rotation(frame: Array, rotation: Array, rest: Array, q: Array) -> None:
    """q = frame rotation rest', (3, 3) each."""
    for i in range(3):
        r0 = frame[i, 0] * rotation[0, 0] + frame[i, 1] * rotation[1, 0] + frame[i, 2] * rotation[2, 0]
        r1 = frame[i, 0] * rotation[0, 1] + frame[i, 1] * rotation[1, 1] + frame[i, 2] * rotation[2, 1]
        r2 = frame[i, 0] * rotation[0, 2] + frame[i, 1] * rotation[1, 2] + frame[i, 2] * rotation[2, 2]
        for j in range(3):
            q[i, j] = r0 * rest[j, 0] + r1 * rest[j, 1] + r2 * rest[j, 2]


@kernel
def _strain_rates(length: float, x3: float, y3: float, jacobian: Array, spin: Array, rate: Array) -> None:
    """``spin`` (3, 9): frame spin by nodal translations; ``rate`` (12, 18): deformations by nodal motions (u, spin)."""
    spin[:] = 0.0
    spin[0, 8] = 1.0 / y3
    spin[0, 5] = -x3 / (length * y3)
    spin[0, 2] = -spin[0, 8] - spin[0, 5]
    spin[1, 2], spin[1, 5] = 1.0 / length, -1.0 / length
    spin[2, 1], spin[2, 4] = -1.0 / length, 1.0 / length
    rate[:] = 0.0
    rate[0, 0], rate[0, 6] = -1.0, 1.0
    rate[1, 0], rate[1, 12] = -1.0, 1.0
    rate[1, 1], rate[1, 7] = -y3 / length, y3 / length
    rate[2, 1], rate[2, 13] = -1.0 + x3 / length, 1.0
    rate[2, 7] = -x3 / length
    for a in range(3):
        for k in range(3):
            row = 3 + a if k == 2 else 6 + 2 * a + k
            h0, h1, h2 = jacobian[a, k, 0], jacobian[a, k, 1], jacobian[a, k, 2]
            rate[row, 6 * a + 3] += h0
            rate[row, 6 * a + 4] += h1
            rate[row, 6 * a + 5] += h2
            for b in range(3):
                rate[row, 6 * b + 1] -= h2 * spin[2, 3 * b + 1]
                rate[row, 6 * b + 2] -= h0 * spin[0, 3 * b + 2] + h1 * spin[1, 3 * b + 2]


@kernel
def _material_tangent(membrane: Array, bending: Array, rate: Array, work: Array, tangent: Array) -> None:
    """tangent (18, 18) = rate' diag(membrane, bending) rate."""
    for i in range(6):
        for j in range(18):
            m = 0.0
            b = 0.0
            for k in range(6):
                m += membrane[i, k] * rate[k, j]
                b += bending[i, k] * rate[6 + k, j]
            work[i, j] = m
            work[6 + i, j] = b
    for i in range(18):
        for j in range(i, 18):
            s = 0.0
            for k in range(12):
                s += rate[k, i] * work[k, j]
            tangent[i, j] = s
            tangent[j, i] = s


@kernel
def _geometric_tangent(length: float, x3: float, y3: float, force: Array, spin: Array, tangent: Array) -> None:
    """Add the change of the force's direction with the frame, and of the frame's equilibrium, in the facet frame."""
    moment = np.zeros((3, 18))
    inertia = np.zeros((3, 3))
    for a in range(3):
        n0, n1, n2 = force[6 * a], force[6 * a + 1], force[6 * a + 2]
        moment[0, 6 * a + 1], moment[0, 6 * a + 2] = n2, -n1
        moment[1, 6 * a], moment[1, 6 * a + 2] = -n2, n0
        moment[2, 6 * a], moment[2, 6 * a + 1] = n1, -n0
        r0 = length if a == 1 else (x3 if a == 2 else 0.0)
        r1 = y3 if a == 2 else 0.0
        along = n0 * r0 + n1 * r1
        inertia[0, 0] += r0 * n0 - along
        inertia[0, 1] += r0 * n1
        inertia[0, 2] += r0 * n2
        inertia[1, 0] += r1 * n0
        inertia[1, 1] += r1 * n1 - along
        inertia[1, 2] += r1 * n2
        inertia[2, 2] -= along
    for b in range(3):
        for c in range(3):
            for i in range(3):
                for k in range(3):
                    moment[i, 6 * b + c] -= inertia[i, k] * spin[k, 3 * b + c]
    for b in range(3):
        for c in range(3):
            g0, g1, g2 = 0.5 * spin[0, 3 * b + c], 0.5 * spin[1, 3 * b + c], 0.5 * spin[2, 3 * b + c]
            column = 6 * b + c
            for block in range(6):
                f0, f1, f2 = force[3 * block], force[3 * block + 1], force[3 * block + 2]
                turned = (f2 * g1 - f1 * g2, f0 * g2 - f2 * g0, f1 * g0 - f0 * g1)
                for i in range(3):
                    tangent[3 * block + i, column] += turned[i]
                    tangent[column, 3 * block + i] += turned[i]
            for j in range(18):
                value = g0 * moment[0, j] + g1 * moment[1, j] + g2 * moment[2, j]
                tangent[column, j] -= value
                tangent[j, column] -= value


@kernel
def _add_turned(tangent: Array, frame: Array, places: NDArray[np.int32], data: Array) -> None:
    """Turn the (18, 18) tangent to global axes and add it to ``data``; ``places`` (324,), -1: not wanted."""
    half = np.zeros((3, 3))
    for a in range(6):
        for b in range(6):
            for i in range(3):
                t0, t1, t2 = tangent[3 * a + i, 3 * b], tangent[3 * a + i, 3 * b + 1], tangent[3 * a + i, 3 * b + 2]
                for j in range(3):
                    half[i, j] = t0 * frame[0, j] + t1 * frame[1, j] + t2 * frame[2, j]
            for i in range(3):
                for j in range(3):
                    place = places[(3 * a + i) * 18 + 3 * b + j]
                    if place >= 0:
                        data[place] += frame[0, i] * half[0, j] + frame[1, i] * half[1, j] + frame[2, i] * half[2, j]


@kernel
def assemble(
    points: Array,
    moved: Array,
    rotation: Array,
    triangles: NDArray[np.int64],
    rest_frame: Array,
    rest_shape: Array,
    membrane: Array,
    bending: Array,
    places: NDArray[np.int32],
    want_tangent: bool,
    data: Array,
    force: Array,
) -> float:
    """Energy, J; fills ``force`` (6 N,) with the internal force and, when wanted, ``data`` with the tangent.

    points, moved : (N, 3) m, positions at rest and displacements; rotation : (N, 3, 3);
    triangles, rest_frame, rest_shape, membrane, bending : see :class:`isf_springback.shell.elements.Facets`;
    places : (T, 324) where each entry of a facet's tangent goes in ``data``, -1 for held freedoms
    """
    force[:] = 0.0
    if want_tangent:
        data[:] = 0.0
    frame, p, q = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    theta, jacobian = np.zeros((3, 3)), np.zeros((3, 3, 3))
    spin, rate, work, tangent = np.zeros((3, 9)), np.zeros((12, 18)), np.zeros((12, 18)), np.zeros((18, 18))
    d, stress, local = np.zeros(12), np.zeros(12), np.zeros(18)
    energy = 0.0
    for e in range(triangles.shape[0]):
        for a in range(3):
            for k in range(3):
                p[a, k] = points[triangles[e, a], k] + moved[triangles[e, a], k]
        length, x3, y3 = _moving_frame(p, frame)
        d[0], d[1], d[2] = length - rest_shape[e, 0], x3 - rest_shape[e, 1], y3 - rest_shape[e, 2]
        for a in range(3):
            _relative_rotation(frame, rotation[triangles[e, a]], rest_frame[e], q)
            _logarithm(q, theta[a], jacobian[a])
            d[3 + a], d[6 + 2 * a], d[7 + 2 * a] = theta[a, 2], theta[a, 0], theta[a, 1]
        for i in range(6):
            m = 0.0
            b = 0.0
            for j in range(6):
                m += membrane[e, i, j] * d[j]
                b += bending[e, i, j] * d[6 + j]
            stress[i] = m
            stress[6 + i] = b
            energy += 0.5 * (m * d[i] + b * d[6 + i])
        _strain_rates(length, x3, y3, jacobian, spin, rate)
        for j in range(18):
            s = 0.0
            for i in range(12):
                s += rate[i, j] * stress[i]
            local[j] = s
        for block in range(6):
            start = 6 * triangles[e, block // 2] + 3 * (block % 2)
            f0, f1, f2 = local[3 * block], local[3 * block + 1], local[3 * block + 2]
            for k in range(3):
                force[start + k] += f0 * frame[0, k] + f1 * frame[1, k] + f2 * frame[2, k]
        if want_tangent:
            _material_tangent(membrane[e], bending[e], rate, work, tangent)
            _geometric_tangent(length, x3, y3, local, spin, tangent)
            _add_turned(tangent, frame, places[e], data)
    return energy


@kernel
def turn_nodes(rotation: Array, spins: Array) -> None:
    """Turn every ``rotation`` (N, 3, 3) by a finite spin (N, 3) rad on the left, in place."""
    turn, product = np.zeros((3, 3)), np.zeros((3, 3))
    for n in range(rotation.shape[0]):
        t0, t1, t2 = spins[n, 0], spins[n, 1], spins[n, 2]
        square = t0 * t0 + t1 * t1 + t2 * t2
        if square < 1e-28:
            continue
        angle = math.sqrt(square)
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        turn[0, 0], turn[1, 1], turn[2, 2] = (
            1 - c * (t1 * t1 + t2 * t2),
            1 - c * (t0 * t0 + t2 * t2),
            1 - c * (t0 * t0 + t1 * t1),
        )
        turn[0, 1], turn[1, 0] = c * t0 * t1 - s * t2, c * t0 * t1 + s * t2
        turn[0, 2], turn[2, 0] = c * t0 * t2 + s * t1, c * t0 * t2 - s * t1
        turn[1, 2], turn[2, 1] = c * t1 * t2 - s * t0, c * t1 * t2 + s * t0
        for i in range(3):
            for j in range(3):
                product[i, j] = (
                    turn[i, 0] * rotation[n, 0, j] + turn[i, 1] * rotation[n, 1, j] + turn[i, 2] * rotation[n, 2, j]
                )
        rotation[n, :, :] = product
