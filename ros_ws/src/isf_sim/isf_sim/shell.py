"""Coarse nonlinear shell: elastic response of the formed sheet in its clamp to the force of a tool.

Nodes on a regular grid with displacements u, v, w (frame ``sheet``); the unloaded shape is the height map of the
actual part. At the clamp w and its slope are zero; in its plane the edge is free (on a weak spring) or fixed.
Energies: :mod:`isf_sim.shell_assembly`. Valid for slopes up to about 60 deg and cells of about 8 mm; the load is
spread over a patch wider than a cell, the compliance below that scale is added by the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from isf_sim.shell_assembly import Section, SupportPoints, add_strain, add_support, assemble, membrane_force
from isf_sim.shell_lines import linear_weights, node_widths
from isf_sim.shell_pattern import make_numbering, number_dofs, star_weights

Array = NDArray[np.float64]

LARGEST_STEP = 4.0e-3
"""m, largest change of w in one Newton step."""
RESIDUAL_TOLERANCE = 1.0e-3
"""Residual over the load at which a solution is accepted."""
STEP_TOLERANCE = 1.0e-7
"""m, change of w at which a solution is accepted."""
SLOW_CONVERGENCE = 0.5
"""The matrix is factorised anew when a step leaves more than this part of the residual."""
LARGEST_ITERATIONS = 40
BALANCE = 0.01
"""Part of the out-of-balance forces of the residual stresses that may be left when the sheet is unloaded."""


@dataclass(frozen=True)
class StrainState:
    """Membrane strain (C, 3) E11, E22, 2 E12 (covariant), curvature (N, 2) and twist (C,) 1/m of the coarse shell."""

    membrane: Array
    bend: Array
    warp: Array


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
    factor : factors of a matrix near the state
    """

    state: Array
    displacement: Array
    axial_compliance: float
    iterations: int
    factorisations: int
    converged: bool
    factor: SuperLU


class _Equilibrium(NamedTuple):
    """State (N, 3) m, factors of a matrix near it, work done."""

    q: Array
    factor: SuperLU
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
        cells = (self.nx - 1) * (self.ny - 1)
        self.residual = StrainState(np.zeros((cells, 3)), np.zeros((self.count, 2)), np.zeros(cells))
        self._number(None)
        self._place_lines(
            *(np.linspace(-0.5, 0.5, n) * length for n, length in zip((self.nx, self.ny), size, strict=True))
        )
        self.set_shape(self.height, self.thickness)
        self._number(self._fill_reducing_order())

    # -- shape ---------------------------------------------------------------------------------

    def move_lines(self, x: Array, y: Array) -> None:
        """Put the lines of the grid to x (nx,), y (ny,) m; they must span the same sheet.

        Residual state, height and thickness are carried over by linear interpolation, so the sheet is out of balance
        by what the interpolation changes.
        """
        nodes = self.onto_lines(x, y)
        old = self.residual
        middle = [0.5 * (lines[1:] + lines[:-1]) for lines in (self.x, self.y, x, y)]
        along_x, along_y = linear_weights(middle[0], middle[2]), linear_weights(middle[1], middle[3])

        def cells(values: Array) -> Array:
            grid = values.reshape(self.ny - 1, self.nx - 1, -1)
            return np.asarray(np.einsum("ab,bcd,ec->aed", along_y, grid, along_x)).reshape(values.shape)

        new = StrainState(cells(old.membrane), nodes(old.bend), cells(old.warp))
        for target, value in zip(vars(old).values(), vars(new).values(), strict=True):
            target[...] = value
        height, thickness = nodes(self.height), nodes(self.thickness)
        self._place_lines(x, y)
        self.set_shape(height, thickness)

    def onto_lines(self, x: Array, y: Array) -> Callable[[Array], Array]:
        """Function that takes values on the nodes (N, ...) to those of a grid with the lines x (nx,), y (ny,) m."""
        along_x, along_y = linear_weights(self.x, x), linear_weights(self.y, y)

        def nodes(values: Array) -> Array:
            grid = values.reshape(self.ny, self.nx, -1)
            return np.asarray(np.einsum("ab,bcd,ec->aed", along_y, grid, along_x)).reshape(values.shape)

        return nodes

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
            strain=self.residual.membrane,
            bend=self.residual.bend,
            warp=self.residual.warp,
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

    def patch_reach(self, x: float, y: float, radius: float) -> float:
        """m, distance from its centre (x, y) m at which the load of a patch of ``radius`` m ends."""
        return 2.0 * max(radius, 0.9 * self.cell_at(x, y))

    def load_patch(self, x: float, y: float, radius: float) -> Array:
        """(N,) weights (sum 1) of a load spread smoothly round (x, y) m."""
        reach = self.patch_reach(x, y, radius)
        distance = (self.node_x - x) ** 2 + (self.node_y - y) ** 2
        weight = np.clip(1.0 - distance / reach**2, 0.0, None) ** 2
        weight[self.boundary] = 0.0
        total = float(weight.sum())
        if total < 1e-9:  # all of the patch lies in the clamp
            weight = np.zeros(self.count)
            weight[np.argmin(distance)] = 1.0
            total = 1.0
        return np.asarray(weight / total)

    @property
    def cells(self) -> NDArray[np.int32]:
        """(C, 4) nodes of each cell."""
        return self._numbering.pattern.cells

    def strain(self, state: Array) -> StrainState:
        """Elastic strains of the displacement ``state`` (N, 3) m, those of the unloaded sheet included."""
        total = StrainState(*(part.copy() for part in vars(self.residual).values()))
        add_strain(state, self._section, self._numbering.pattern, total.membrane, total.bend, total.warp)
        return total

    def membrane_force(self, strain: StrainState) -> Array:
        """(N,) N/m, von Mises equivalent membrane force at the nodes (mean of the cells round them)."""
        force = np.empty(len(self.cells))
        membrane_force(strain.membrane, self._section, self._numbering.pattern, force)
        around = np.bincount(self.cells.ravel(), minlength=self.count)
        return np.asarray(np.bincount(self.cells.ravel(), np.repeat(force, 4), self.count) / around)

    def rebase(self, state: Array) -> None:
        """Make ``state`` (N, 3) m part of the unloaded sheet: its strains stay as residual ones.

        The caller adds the axial part to the height.
        """
        residual = self.residual
        add_strain(state, self._section, self._numbering.pattern, residual.membrane, residual.bend, residual.warp)

    def solve(self, patch: Array, force: Array, start: Array | None = None) -> Deflection:
        """Equilibrium with ``force`` (3,) N spread by ``patch`` (N,), from the state ``start`` (N, 3) m."""
        q = np.zeros((self.count, 3)) if start is None else start.copy()
        load = self._flat(patch[:, None] * force)
        scale = float(np.linalg.norm(load)) + 1e-9
        found = self._equilibrium(q, load, RESIDUAL_TOLERANCE * scale, near=start is not None)
        compliance = self._axial_compliance(patch, found.q, found.factor)
        return Deflection(found.q, patch @ found.q, compliance, *found[2:5], found.factor)

    def unload(self, factor: SuperLU | None = None) -> Array:
        """(N, 3) m, displacement without load: where the residual stresses balance each other.

        ``factor``: of a matrix of the loaded sheet, to begin with.
        """
        q = np.zeros((self.count, 3))
        first = float(np.linalg.norm(self._assemble(q, tangent=False)))
        if first == 0.0:
            return q
        found = self._equilibrium(q, np.zeros(self._numbering.count), BALANCE * first, near=False, factor=factor)
        return found.q if found.converged else q

    def _equilibrium(
        self, q: Array, load: Array, tolerance: float, *, near: bool, factor: SuperLU | None = None
    ) -> _Equilibrium:
        """Modified Newton from ``q``: the factorised matrix is kept as long as a step leaves less than
        SLOW_CONVERGENCE of the residual. ``near``: the start itself may be accepted; ``factor``: first matrix."""
        fresh = factor is None
        inner = self._assemble(q, tangent=fresh)
        iterations, factorisations = 0, 0
        if factor is None:
            factor, factorisations = self._factorise(), 1
        residual = load - inner
        size = float(np.linalg.norm(residual))
        converged = size < tolerance and near
        while not converged and iterations < LARGEST_ITERATIONS:
            step = self._unflat(factor.solve(residual))
            largest = float(np.abs(step[:, 2]).max())
            shrink = min(1.0, LARGEST_STEP / max(largest, 1e-12))
            iterations += 1
            while True:
                trial = q + shrink * step
                trial_residual = load - self._assemble(trial, tangent=False)
                trial_size = float(np.linalg.norm(trial_residual))
                accepted = trial_size < 1.5 * size or shrink < 0.1 or iterations <= 2
                if accepted or not fresh:
                    break
                shrink *= 0.5
            slow = not accepted or trial_size > SLOW_CONVERGENCE * size
            if accepted or fresh:
                q, residual, size = trial, trial_residual, trial_size
                converged = size < tolerance or (fresh and largest * shrink < STEP_TOLERANCE)
            fresh = False
            if slow and not converged:  # the old matrix misled, or is not good enough any more
                self._assemble(q, tangent=True)
                factor = self._factorise()
                factorisations += 1
                fresh = True
        return _Equilibrium(q, factor, iterations, factorisations, converged)

    def _axial_compliance(self, patch: Array, q: Array, factor: SuperLU) -> float:
        """Tangent at ``q`` (m/N) with the factors of a nearby state: three steps of iterative refinement."""
        self._assemble(q, tangent=True)
        matrix = self._matrix()
        load = self._flat(patch[:, None] * np.array([0.0, 0.0, 1.0]))
        response = factor.solve(load)
        for _ in range(3):
            response += factor.solve(load - matrix @ response)
        return float(load @ response)

    # -- linear algebra ----------------------------------------------------------------------------

    def _number(self, order: NDArray[np.int32] | None) -> None:
        dof = number_dofs(self._active, order)
        self._numbering = make_numbering(self.nx, self.ny, dof)
        self._force = np.zeros(self._numbering.count + 1)
        self._values = np.zeros(len(self._numbering.rows) + 1)
        if order is not None:
            self._set_springs()

    def _set_springs(self) -> None:
        numbering = self._numbering
        springs = np.zeros(numbering.count + 1)
        for axis in range(2):
            springs[numbering.dof[:, axis]] += self.edge_stiffness
        self._springs = springs[:-1]

    def _fill_reducing_order(self) -> NDArray[np.int32]:
        """Ordering found once; later factorisations use the natural order of the renumbered dofs."""
        self._assemble(np.zeros((self.count, 3)), tangent=True)
        return np.asarray(self._factorise("MMD_AT_PLUS_A").perm_c)

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

    def _factorise(self, order: str = "NATURAL") -> SuperLU:
        return splu(self._matrix(), permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def _flat(self, values: Array) -> Array:
        out = np.empty(self._numbering.count)
        out[self._numbering.dof[self._active]] = values[self._active]
        return out

    def _unflat(self, values: Array) -> Array:
        out = np.zeros((self.count, 3))
        out[self._active] = values[self._numbering.dof[self._active]]
        return out
