"""Forces and tangent of the coarse shell: Koiter membrane on a height field, Marguerre bending.

With z0 the height of the unloaded sheet and (u, v, w) its displacement, the membrane strain is

    E11 = u,x + z0,x w,x + w,x^2/2        E22 = v,y + z0,y w,y + w,y^2/2
    2 E12 = u,y + v,x + z0,x w,y + z0,y w,x + w,x w,y

in covariant components; the metric a_ab = d_ab + z0,a z0,b enters through the elastic tensor
H^abcd = E/(1-nu^2) [nu a^ab a^cd + (1-nu)/2 (a^ac a^bd + a^ad a^bc)]. Bending is linear in w with
D/sqrt(a). The unloaded sheet is without stress. Cells are rectangles of any size along the axes, integrated at one
point, with an hourglass stiffness on u, v that depends on their shape alone; curvatures are three-point differences,
exact for a parabola on any lines.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel

Index = NDArray[np.int32]

HOURGLASS = 0.02
"""Stiffness of the in-plane hourglass modes over E t."""


class Pattern(NamedTuple):
    """Where the shares of cells and nodes go; inactive dofs point to one slot past the end.

    Attributes
    ----------
    cells : (C, 4) nodes (0,0), (1,0), (0,1), (1,1) of each cell
    cell_dof : (C, 12) dof of u, v, w at these nodes ; cell_slot : (C, 12, 12) place in the matrix values
    star : (N, 5) node, left, right, down, up ; star_dof : (N, 5) their w dofs ; star_slot : (N, 5, 5)
    """

    cells: Index
    cell_dof: Index
    cell_slot: Index
    star: Index
    star_dof: Index
    star_slot: Index


class SupportPoints(NamedTuple):
    """Points of a one-sided rigid support under the cells.

    Attributes
    ----------
    cell : (P,) cell over each point ; share : (P, 4) bilinear weights of its nodes
    clearance : (P,) m, lower face of the unloaded sheet minus support ; stiffness : (P,) N/m
    """

    cell: Index
    share: Array
    clearance: Array
    stiffness: Array


def no_support_points() -> SupportPoints:
    """Nothing under the sheet."""
    return SupportPoints(np.zeros(0, dtype=np.int32), np.zeros((0, 4)), np.zeros(0), np.zeros(0))


class Section(NamedTuple):
    """Sheet as the kernels need it: (C,) dx, dy m of the cells; (N, 5) star_xx, star_yy 1/m^2, second differences with
    zero slope at the clamp; E Pa; nu; (N,) height m, thickness m, bending weight N m^3, (C,) twist weight N m^3."""

    dx: Array
    dy: Array
    star_xx: Array
    star_yy: Array
    young: float
    poisson: float
    height: Array
    thickness: Array
    bending: Array
    twist: Array


@kernel
def assemble(q: Array, section: Section, pattern: Pattern, tangent: bool, force: Array, values: Array) -> None:
    """Inner forces (n+1,) N of the state q (N, 3) m and, if asked, the matrix values (nnz+1,) N/m."""
    force[:] = 0.0
    if tangent:
        values[:] = 0.0
    _add_membrane(q, section, pattern, tangent, force, values)
    _add_bending(q, section, pattern, tangent, force, values)


@kernel
def _add_membrane(q: Array, section: Section, pattern: Pattern, tangent: bool, force: Array, values: Array) -> None:
    young, nu = section.young, section.poisson
    gx, gy = np.empty(4), np.empty(4)
    hourglass = np.array([1.0, -1.0, -1.0, 1.0])
    b = np.zeros((3, 12))
    db = np.zeros((3, 12))
    d = np.zeros((3, 3))
    strain = np.zeros(3)
    slope = np.zeros(2)
    stress = np.zeros(3)
    for c in range(pattern.cells.shape[0]):
        nodes = pattern.cells[c]
        dx, dy = section.dx[c], section.dy[c]
        _gradients(dx, dy, gx, gy)
        zx = zy = wx = wy = t = hu = hv = 0.0
        ux = uy = vx = vy = 0.0
        for a in range(4):
            n = nodes[a]
            zx += gx[a] * section.height[n]
            zy += gy[a] * section.height[n]
            ux += gx[a] * q[n, 0]
            uy += gy[a] * q[n, 0]
            vx += gx[a] * q[n, 1]
            vy += gy[a] * q[n, 1]
            wx += gx[a] * q[n, 2]
            wy += gy[a] * q[n, 2]
            hu += hourglass[a] * q[n, 0]
            hv += hourglass[a] * q[n, 1]
            t += 0.25 * section.thickness[n]
        _elastic_tensor(zx, zy, young, nu, t * dx * dy, d)
        strain[0] = ux + zx * wx + 0.5 * wx * wx
        strain[1] = vy + zy * wy + 0.5 * wy * wy
        strain[2] = uy + vx + zx * wy + zy * wx + wx * wy
        slope[0] = zx + wx
        slope[1] = zy + wy
        for r in range(3):
            stress[r] = d[r, 0] * strain[0] + d[r, 1] * strain[1] + d[r, 2] * strain[2]
        for a in range(4):
            b[0, a], b[0, 8 + a] = gx[a], slope[0] * gx[a]
            b[1, 4 + a], b[1, 8 + a] = gy[a], slope[1] * gy[a]
            b[2, a], b[2, 4 + a], b[2, 8 + a] = gy[a], gx[a], slope[0] * gy[a] + slope[1] * gx[a]
        stiff = HOURGLASS * young * t * 0.5 * (dx / dy + dy / dx)
        dof = pattern.cell_dof[c]
        for r in range(12):
            force[dof[r]] += b[0, r] * stress[0] + b[1, r] * stress[1] + b[2, r] * stress[2]
        for a in range(4):
            force[dof[a]] += stiff * hourglass[a] * hu
            force[dof[4 + a]] += stiff * hourglass[a] * hv
        if not tangent:
            continue
        slot = pattern.cell_slot[c]
        for r in range(3):
            for s in range(12):
                db[r, s] = d[r, 0] * b[0, s] + d[r, 1] * b[1, s] + d[r, 2] * b[2, s]
        for r in range(12):
            for s in range(12):
                values[slot[r, s]] += b[0, r] * db[0, s] + b[1, r] * db[1, s] + b[2, r] * db[2, s]
        for a in range(4):
            for s in range(4):
                k = stiff * hourglass[a] * hourglass[s]
                values[slot[a, s]] += k
                values[slot[4 + a, 4 + s]] += k
                values[slot[8 + a, 8 + s]] += (
                    stress[0] * gx[a] * gx[s] + stress[1] * gy[a] * gy[s] + stress[2] * (gx[a] * gy[s] + gy[a] * gx[s])
                )


@kernel
def _gradients(dx: float, dy: float, gx: Array, gy: Array) -> None:
    """Derivatives 1/m of the four shape functions in the middle of a cell."""
    gx[0] = gx[2] = -0.5 / dx
    gx[1] = gx[3] = 0.5 / dx
    gy[0] = gy[1] = -0.5 / dy
    gy[2] = gy[3] = 0.5 / dy


@kernel
def _elastic_tensor(zx: float, zy: float, young: float, nu: float, volume: float, d: Array) -> None:
    """Contravariant plane-stress tensor in Voigt order times the cell's volume ``t dx dy sqrt(a)``."""
    a11, a22, a12 = 1.0 + zx * zx, 1.0 + zy * zy, zx * zy
    det = a11 * a22 - a12 * a12
    b11, b22, b12 = a22 / det, a11 / det, -a12 / det
    k = young / (1.0 - nu * nu) * volume * np.sqrt(det)
    d[0, 0] = k * b11 * b11
    d[1, 1] = k * b22 * b22
    d[0, 1] = d[1, 0] = k * (nu * b11 * b22 + (1.0 - nu) * b12 * b12)
    d[0, 2] = d[2, 0] = k * b11 * b12
    d[1, 2] = d[2, 1] = k * b22 * b12
    d[2, 2] = k * (nu * b12 * b12 + 0.5 * (1.0 - nu) * (b11 * b22 + b12 * b12))


@kernel
def _add_bending(q: Array, section: Section, pattern: Pattern, tangent: bool, force: Array, values: Array) -> None:
    nu = section.poisson
    for n in range(pattern.star.shape[0]):
        kx = ky = 0.0
        for a in range(5):
            w = q[pattern.star[n, a], 2]
            kx += section.star_xx[n, a] * w
            ky += section.star_yy[n, a] * w
        weight = section.bending[n]
        mx, my = weight * (kx + nu * ky), weight * (ky + nu * kx)
        for a in range(5):
            xa, ya = section.star_xx[n, a], section.star_yy[n, a]
            force[pattern.star_dof[n, a]] += xa * mx + ya * my
            if tangent:
                for s in range(5):
                    xs, ys = section.star_xx[n, s], section.star_yy[n, s]
                    values[pattern.star_slot[n, a, s]] += weight * (xa * xs + ya * ys + nu * (xa * ys + ya * xs))
    corner = np.array([1.0, -1.0, -1.0, 1.0])
    sign = np.empty(4)
    for c in range(pattern.cells.shape[0]):
        sign[:] = corner / (section.dx[c] * section.dy[c])
        twist = 0.0
        for a in range(4):
            twist += sign[a] * q[pattern.cells[c, a], 2]
        weight = 2.0 * (1.0 - nu) * section.twist[c]
        for a in range(4):
            force[pattern.cell_dof[c, 8 + a]] += weight * sign[a] * twist
            if tangent:
                for s in range(4):
                    values[pattern.cell_slot[c, 8 + a, 8 + s]] += weight * sign[a] * sign[s]


@kernel
def add_support(q: Array, support: SupportPoints, pattern: Pattern, tangent: bool, force: Array, values: Array) -> None:
    """Add the reaction of the support where the sheet lies on it (penalty, one-sided)."""
    for p in range(support.cell.shape[0]):
        c = support.cell[p]
        gap = support.clearance[p]
        for a in range(4):
            gap += support.share[p, a] * q[pattern.cells[c, a], 2]
        if gap >= 0.0:
            continue
        stiffness = support.stiffness[p]
        for a in range(4):
            force[pattern.cell_dof[c, 8 + a]] += stiffness * gap * support.share[p, a]
            if tangent:
                for s in range(4):
                    share = support.share[p, a] * support.share[p, s]
                    values[pattern.cell_slot[c, 8 + a, 8 + s]] += stiffness * share
