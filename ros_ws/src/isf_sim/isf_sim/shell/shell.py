"""Coarse nonlinear shell: elastic response of the formed sheet in its clamp to the force of a tool.

Nodes where lines along x and y cross (:mod:`isf_sim.shell.shell_lines`), with displacements u, v, w (frame ``sheet``);
the unloaded shape is the height map of the actual part. At the clamp w and its slope are zero; in its plane the edge is
free (on a weak spring) or fixed. Energies: :mod:`isf_sim.shell.shell_assembly`; solution:
:mod:`isf_sim.shell.shell_equilibrium`.
Valid for slopes up to about 60 deg; the load is spread over a patch wider than a cell, the compliance below that
scale is added by the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from isf_core.types import Array

from isf_sim.shell.shell_assembly import Section, SupportPoints, add_support, assemble, no_support_points
from isf_sim.shell.shell_equilibrium import Factors, Problem, Room, compliance_at, find_equilibrium
from isf_sim.shell.shell_factor import KeptFactor, band_form
from isf_sim.shell.shell_lines import linear_weights, node_widths
from isf_sim.shell.shell_pattern import make_numbering, number_dofs, star_weights

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
        self._kept.drop()
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
        """One-sided rigid support under the sheet (plate, die), see :func:`isf_sim.sheet.support.support_points`."""
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
        q = np.zeros(self._numbering.count) if start is None else self._flat(start)
        load, axial = self._flat(patch[:, None] * force), self._flat(patch[:, None] * np.array([0.0, 0.0, 1.0]))
        tolerance = RESIDUAL_TOLERANCE * (float(np.linalg.norm(load)) + 1e-9)
        problem, factors, room = self.problem(), self.factors(), self._room.arrays
        work = find_equilibrium(q, load, tolerance, self._kept.known, problem, factors, room)
        compliance, more = compliance_at(q, axial, COMPLIANCE_TOLERANCE, problem, factors, room)
        self._kept.known = True
        state = self._unflat(q)
        return Deflection(state, patch @ state, compliance, work.iterations, work.factorisations + more, work.converged)

    def inner_force(self, state: Array) -> Array:
        """(n + 1,) N, what the sheet with ``state`` (N, 3) m and the springs of its edge put against a displacement of
        each degree of freedom; last the sum over those that the clamp holds."""
        room, problem = self._room.arrays, self.problem()
        assemble(state, problem.section, problem.pattern, False, room.force, room.values)
        add_support(state, problem.support, problem.pattern, False, room.force, room.values)
        return np.asarray(room.force + np.append(self._springs * self._flat(state), 0.0))

    def problem(self) -> Problem:
        """The sheet as it is, for :mod:`isf_sim.shell.shell_equilibrium`; its arrays belong to the shell."""
        numbering = self._numbering
        return Problem(
            section=self._section,
            pattern=numbering.pattern,
            support=self.support or no_support_points(),
            form=self._form,
            springs=self._springs,
            diagonal=numbering.diagonal,
            place=self._place,
        )

    def factors(self) -> Factors:
        """The kept factors; they belong to the shell."""
        kept = self._kept
        return Factors(kept.values, kept.made.band, kept.made.of, kept.made.shift)

    # -- linear algebra ----------------------------------------------------------------------------

    def _number(self) -> None:
        dof = number_dofs(self._active, self.nx, self.ny)
        self._numbering = numbering = make_numbering(self.nx, self.ny, dof)
        self._place = np.empty(numbering.count, dtype=np.int64)
        self._place[dof[self._active]] = np.flatnonzero(self._active)
        self._form = band_form(numbering.rows, numbering.starts)
        self._kept = KeptFactor(self._form)
        self._room = Room(self.count, numbering.count, len(numbering.rows))

    def _set_springs(self) -> None:
        numbering = self._numbering
        springs = np.zeros(numbering.count + 1)
        for axis in range(2):
            springs[numbering.dof[:, axis]] += self.edge_stiffness
        self._springs = springs[:-1]

    def _flat(self, values: Array) -> Array:
        return np.ascontiguousarray(values).reshape(-1)[self._place]

    def _unflat(self, values: Array) -> Array:
        out = np.zeros((self.count, 3))
        out.reshape(-1)[self._place] = values
        return out
