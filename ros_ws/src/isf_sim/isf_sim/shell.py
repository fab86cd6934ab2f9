"""Coarse nonlinear shell: elastic response of the formed sheet in its clamp to the force of a tool.

Nodes where lines along x and y cross (:mod:`isf_sim.shell_lines`), with displacements u, v, w (frame ``sheet``); the
unloaded shape is the height map of the actual part. At the clamp w and its slope are zero; in its plane the edge is
free (on a weak spring) or fixed. Energies: :mod:`isf_sim.shell_assembly`; solution: :mod:`isf_sim.shell_equilibrium`.
Valid for slopes up to about 60 deg; the load is spread over a patch wider than a cell, the compliance below that
scale is added by the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from isf_sim.shell_assembly import Section, SupportPoints, add_support, assemble
from isf_sim.shell_equilibrium import conjugate_gradients, find_equilibrium
from isf_sim.shell_factor import BandForm, Factor, KeptFactor
from isf_sim.shell_lines import linear_weights, node_widths
from isf_sim.shell_pattern import make_numbering, number_dofs, star_weights

Array = NDArray[np.float64]

RESIDUAL_TOLERANCE = 1.0e-5
"""Residual over the load at which a solution is accepted."""
COMPLIANCE_TOLERANCE = 1.0e-2
"""The same for the tangent, whose own error goes with the square of it."""


@dataclass(frozen=True)
class Elastic:
    """Isotropic sheet: Young's modulus Pa, Poisson's ratio."""

    young: float
    poisson: float


@dataclass(frozen=True)
class Deflection:
    """Equilibrium under one tool force.

    Attributes
    ----------
    state : (N, 3) m, displacement of all nodes
    displacement : (3,) m, at the tool (patch average)
    axial_compliance : m/N, tangent dw/dF at the tool
    iterations, factorisations : work done
    converged : False when the iteration limit was hit
    """

    state: Array
    displacement: Array
    axial_compliance: float
    iterations: int
    factorisations: int
    converged: bool


class Shell:
    """Grid, clamp and present shape of the coarse shell.

    Parameters
    ----------
    size : m, free sheet between the clamps (x, y) ; cell : m, largest cell size
    thickness : m ; edge : in-plane condition ; edge_spring : N/m^2, in-plane stiffness per edge length (free edge)
    """

    def __init__(
        self,
        size: tuple[float, float],
        cell: float,
        elastic: Elastic,
        thickness: float,
        *,
        edge: Literal["free", "fixed"] = "free",
        edge_spring: float = 1.0e6,
    ) -> None:
        self.nx, self.ny = (max(4, round(length / cell)) + 1 for length in size)
        self.elastic = elastic
        self.count = self.nx * self.ny
        inside = np.zeros((self.ny, self.nx), dtype=bool)
        inside[1:-1, 1:-1] = True
        self.boundary = ~inside.ravel()
        self._active = np.ones((self.count, 3), dtype=bool)
        self._active[self.boundary, 2] = False
        if edge == "fixed":
            self._active[self.boundary] = False
        self._edge_spring = edge_spring if edge == "free" else 0.0
        self.height = np.zeros(self.count)
        self.thickness = np.full(self.count, thickness)
        self.support: SupportPoints | None = None
        self._number()
        self._place_lines(
            *(np.linspace(-0.5, 0.5, n) * length for n, length in zip((self.nx, self.ny), size, strict=True))
        )
        self.set_shape(self.height, self.thickness)

    # -- shape ---------------------------------------------------------------------------------

    def move_lines(self, x: Array, y: Array) -> None:
        """Put the lines of the grid to x (nx,), y (ny,) m; they must span the same sheet.

        Height and thickness are carried over by linear interpolation.
        """
        nodes = self.onto_lines(x, y)
        height, thickness = nodes(self.height), nodes(self.thickness)
        self._factor.drop()
        self._place_lines(x, y)
        self.set_shape(height, thickness)

    def onto_lines(self, x: Array, y: Array) -> Callable[[Array], Array]:
        """Function that takes values on the nodes (N, ...) to those of a grid with the lines x (nx,), y (ny,) m.

        By linear interpolation.
        """
        along_x, along_y = linear_weights(self.x, x), linear_weights(self.y, y)

        def between(values: Array) -> Array:
            grid = np.tensordot(along_y, values.reshape(self.ny, self.nx, -1), axes=(1, 0))
            return np.asarray(np.tensordot(along_x, grid, axes=(1, 1)).swapaxes(0, 1).reshape(values.shape))

        return between

    def _place_lines(self, x: Array, y: Array) -> None:
        self.x, self.y = np.ascontiguousarray(x), np.ascontiguousarray(y)
        gx, gy = np.meshgrid(self.x, self.y)
        self.node_x, self.node_y = gx.ravel(), gy.ravel()
        dx, dy = np.meshgrid(np.diff(self.x), np.diff(self.y))
        self.cell_x, self.cell_y = dx.ravel(), dy.ravel()
        width_x, width_y = node_widths(self.x), node_widths(self.y)
        self.node_area = np.outer(width_y, width_x).ravel()
        self._star_xx, self._star_yy = star_weights(self.x, self.y)
        length = np.zeros((self.ny, self.nx))
        length[[0, -1], :] += width_x
        length[:, [0, -1]] += width_y[:, None]
        self.edge_stiffness = self._edge_spring * length.ravel()
        self._set_springs()

    def set_shape(self, height: Array, thickness: Array) -> None:
        """Unloaded height (N,) m and thickness (N,) m of the sheet."""
        self.height = np.ascontiguousarray(height)
        self.thickness = np.ascontiguousarray(thickness)
        zy, zx = np.gradient(self.height.reshape(self.ny, self.nx), self.y, self.x)
        weight = (self.rigidity / np.sqrt(1.0 + zx**2 + zy**2).ravel()).reshape(self.ny, self.nx)
        corner = weight[:-1, :-1] + weight[:-1, 1:] + weight[1:, :-1] + weight[1:, 1:]
        self._section = Section(
            dx=self.cell_x,
            dy=self.cell_y,
            star_xx=self._star_xx,
            star_yy=self._star_yy,
            young=self.elastic.young,
            poisson=self.elastic.poisson,
            height=self.height,
            thickness=self.thickness,
            bending=self.node_area * weight.ravel(),
            twist=0.25 * corner.ravel() * self.cell_x * self.cell_y,
        )

    def set_support(self, support: SupportPoints | None) -> None:
        """One-sided rigid support under the sheet (backing plate, die), see :func:`isf_sim.support.support_points`."""
        self.support = support

    @property
    def rigidity(self) -> Array:
        """(N,) N m, bending stiffness D = E t^3 / (12 (1 - nu^2))."""
        return np.asarray(self.elastic.young * self.thickness**3 / (12.0 * (1.0 - self.elastic.poisson**2)))

    # -- loads and states ------------------------------------------------------------------------

    def cell_at(self, x: float, y: float) -> float:
        """m, longer side of the cell at (x, y) m."""
        sides = []
        for lines, place in ((self.x, x), (self.y, y)):
            k = min(max(int(np.searchsorted(lines, place)) - 1, 0), len(lines) - 2)
            sides.append(float(lines[k + 1] - lines[k]))
        return max(sides)

    def load_patch(self, x: float, y: float, radius: float) -> Array:
        """(N,) weights (sum 1) of a load spread smoothly round (x, y) m."""
        reach = 2.0 * max(radius, 0.9 * self.cell_at(x, y))
        distance = (self.node_x - x) ** 2 + (self.node_y - y) ** 2
        weight = np.clip(1.0 - distance / reach**2, 0.0, None) ** 2
        weight[self.boundary] = 0.0
        total = float(weight.sum())
        if total < 1e-9:  # all of the patch lies in the clamp
            weight = np.zeros(self.count)
            weight[np.argmin(distance)] = 1.0
            total = 1.0
        return np.asarray(weight / total)

    def solve(self, patch: Array, force: Array, start: Array | None = None) -> Deflection:
        """Equilibrium with ``force`` (3,) N spread by ``patch`` (N,), from the state ``start`` (N, 3) m."""
        begin = np.zeros(self._numbering.count) if start is None else self._flat(start)
        load = self._flat(patch[:, None] * force)
        tolerance = RESIDUAL_TOLERANCE * (float(np.linalg.norm(load)) + 1e-9)
        found = find_equilibrium(begin, self._factor.get(), lambda q: load - self._inner(q), self._renew, tolerance)
        state = self._unflat(found.q)
        compliance, more = self._axial_compliance(patch, state, found.factor)
        return Deflection(
            state, patch @ state, compliance, found.iterations, found.factorisations + more, found.converged
        )

    def _inner(self, q: Array) -> Array:
        return self._assemble(self._unflat(q), tangent=False)

    def _renew(self, q: Array) -> Factor:
        """Factors of the matrix of the state ``q`` (n,) m, kept for the next solution."""
        self._assemble(self._unflat(q), tangent=True)
        return self._factor.renew(self._values[:-1])

    def _axial_compliance(self, patch: Array, state: Array, factor: Factor) -> tuple[float, int]:
        """Tangent at ``state`` (m/N) with the factors of a nearby one; factorisations that it took."""
        load = self._flat(patch[:, None] * np.array([0.0, 0.0, 1.0]))
        self._assemble(state, tangent=True)
        matrix = self._matrix()
        response = conjugate_gradients(lambda x: matrix @ x, factor, load, COMPLIANCE_TOLERANCE)
        if response is not None:
            return float(load @ response), 0
        return float(load @ self._factor.renew(self._values[:-1]).solve(load)), 1

    # -- linear algebra ----------------------------------------------------------------------------

    def _number(self) -> None:
        dof = number_dofs(self._active, self.nx, self.ny)
        self._numbering = make_numbering(self.nx, self.ny, dof)
        self._force = np.zeros(self._numbering.count + 1)
        self._values = np.zeros(len(self._numbering.rows) + 1)
        form = BandForm(self._numbering.rows, self._numbering.starts)
        self._factor = KeptFactor(form, len(self._numbering.rows))

    def _set_springs(self) -> None:
        numbering = self._numbering
        springs = np.zeros(numbering.count + 1)
        for axis in range(2):
            springs[numbering.dof[:, axis]] += self.edge_stiffness
        self._springs = springs[:-1]

    def _assemble(self, q: Array, *, tangent: bool) -> Array:
        numbering = self._numbering
        assemble(q, self._section, numbering.pattern, tangent, self._force, self._values)
        if self.support is not None:
            add_support(q, self.support, numbering.pattern, tangent, self._force, self._values)
        if tangent:
            self._values[numbering.diagonal] += self._springs
        return np.asarray(self._force[:-1] + self._springs * self._flat(q))

    def _matrix(self) -> csc_matrix:
        numbering = self._numbering
        shape = (numbering.count, numbering.count)
        return csc_matrix((self._values[:-1], numbering.rows, numbering.starts), shape=shape, copy=False)

    def _flat(self, values: Array) -> Array:
        out = np.empty(self._numbering.count)
        out[self._numbering.dof[self._active]] = values[self._active]
        return out

    def _unflat(self, values: Array) -> Array:
        out = np.zeros((self.count, 3))
        out[self._active] = values[self._numbering.dof[self._active]]
        return out
