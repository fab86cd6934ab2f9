"""One clamped sheet as an elastic body: mesh, edge condition, state, tangent and its factor.

Lengths in m, forces in N, frame ``sheet``. Free unknowns are the translations (m) and spins of the nodes that the
edge does not hold; spins count as metres at a lever of 1 mm, so that one tolerance fits all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import SuperLU, splu

from isf_springback.shell.corotation import assemble, turn_nodes
from isf_springback.shell.elements import facet_frames, make_facets

Index = NDArray[np.int64]

LEVER = 1e-3
"""m; lever at which a spin counts as a displacement."""

_SHIFTS = (0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
"""Parts of the diagonal added until the tangent can be factored."""


@dataclass(frozen=True)
class EdgeCondition:
    """How the clamp holds the edge; the deflection is always held.

    Attributes
    ----------
    slope : "clamped" holds the slope, "supported" leaves it free
    in_plane : N/m per m of edge (Pa), in-plane spring; 0 = free to move, infinite = immovable
    """

    slope: Literal["clamped", "supported"] = "clamped"
    in_plane: float = 0.0

    @property
    def immovable(self) -> bool:
        """The edge cannot move in its plane."""
        return bool(np.isinf(self.in_plane))


@dataclass(frozen=True)
class SheetMesh:
    """Middle surface of a sheet at rest.

    Attributes
    ----------
    points : (N, 3) m
    triangles : (T, 3) node numbers, counter-clockwise from above
    edge : (K,) nodes on the clamped edge, in order around the sheet
    loaded : (M,) nodes that stand on control points, in their order
    propped : (K,) nodes on the edge of a backing plate, which holds their deflection
    """

    points: Array
    triangles: Index
    edge: Index
    loaded: Index
    propped: Index = field(default_factory=lambda: np.empty(0, dtype=np.int64))


def sine_law_thickness(mesh: SheetMesh, initial: float) -> Array:
    """(T,) m, thickness of every facet by the sine law t0 |n_z| (Ren 2018, 1.1.2 and 4.2.3)."""
    frame, _ = facet_frames(mesh.points[mesh.triangles])
    return np.asarray(initial * np.abs(frame[:, 2, 2]))


@dataclass(frozen=True)
class Factor:
    """Factors of a tangent, in single precision: they steer iterations whose residual is known in double precision.

    Attributes
    ----------
    lower_upper : of the tangent scaled to a diagonal of about one
    scale : (F,) that scaling, and the units of the unknowns
    """

    lower_upper: SuperLU
    scale: Array

    def solve(self, force: Array) -> Array:
        """(F,) m, answer to ``force`` (F,) N, Nm, of the unknowns in m and per LEVER rad."""
        scaled = (force * self.scale).astype(np.float32)
        return np.asarray(self.lower_upper.solve(scaled) * self.scale, dtype=np.float64)


class ShellModel:
    """Elastic state of one sheet: displacement, rotations and the factored tangent.

    Attributes
    ----------
    moved : (N, 3) m, displacement
    rotation : (N, 3, 3)
    internal : (6 N,) internal force and moment, filled by :meth:`evaluate`
    factorizations, evaluations : counted since the model was made
    """

    def __init__(self, mesh: SheetMesh, thickness: Array, young: float, poisson: float, edge: EdgeCondition) -> None:
        self.mesh = mesh
        self._facets = make_facets(mesh.points, mesh.triangles, thickness, young, poisson)
        count = len(mesh.points)
        self.moved = np.zeros((count, 3))
        self.rotation = np.tile(np.eye(3), (count, 1, 1))
        self.internal = np.zeros(6 * count)
        self.factorizations = 0
        self.evaluations = 0
        self.energy = 0.0
        self._order = _elimination_order(mesh.triangles, count)
        free = np.ones(6 * count, dtype=bool)
        free[held_freedoms(mesh, edge)] = False
        self.free = (6 * self._order[:, None] + np.arange(6)).ravel()
        self.free = self.free[free[self.free]]
        self._unit = np.where(self.free % 6 < 3, 1.0, 1.0 / LEVER)
        self._edge_spring = edge_springs(mesh, edge)
        self._make_pattern(count)
        self._factor: Factor | None = None

    def _make_pattern(self, count: int) -> None:
        """Compressed columns of the tangent in elimination order, and the place of every facet entry in them.

        Built from pairs of nodes: each is a block of 6 x 6 entries, of which the held freedoms are then taken out.
        """
        rank = np.empty(count, dtype=np.int64)
        rank[self._order] = np.arange(count)
        corner = rank[self.mesh.triangles]
        row, column = np.repeat(corner, 3, axis=1).ravel(), np.tile(corner, (1, 3)).ravel()
        key, pair = np.unique(column * count + row, return_inverse=True)
        pair_row, pair_column = key % count, key // count
        first = np.searchsorted(pair_column, np.arange(count + 1))
        degree = np.diff(first)
        # entry (row 6 i + r, column 6 j + c) of pair p stands at 36 first(j) + 6 c degree(j) + 6 (p - first(j)) + r
        base = 36 * first[pair_column] + 6 * (np.arange(len(key)) - first[pair_column])
        six = np.arange(6)
        place = base[:, None, None] + six[:, None] + 6 * degree[pair_column][:, None, None] * six  # (P, r, c)
        number = np.full(6 * count, -1, dtype=np.int64)
        number[6 * rank[self.free // 6] + self.free % 6] = np.arange(len(self.free))
        rows, columns = np.empty(36 * len(key), dtype=np.int64), np.empty(36 * len(key), dtype=np.int64)
        rows[place] = number[6 * pair_row[:, None] + six][:, :, None]
        columns[place] = number[6 * pair_column[:, None] + six][:, None, :]
        wanted = (rows >= 0) & (columns >= 0)
        compressed = np.where(wanted, np.cumsum(wanted) - 1, -1)
        blocks = compressed[place][pair.reshape(-1, 3, 3)]  # (T, corner, corner, r, c)
        self._places = np.ascontiguousarray(blocks.transpose(0, 1, 3, 2, 4).reshape(-1, 324), dtype=np.int32)
        rows, columns = rows[wanted], columns[wanted]
        self._data = np.zeros(len(rows))
        self._rows = rows.astype(np.int32)
        self._starts = np.searchsorted(columns, np.arange(len(self.free) + 1)).astype(np.int32)
        self._scale = self._unit[rows] * self._unit[columns]
        self._diagonal = np.flatnonzero(rows == columns)

    def reset(self) -> None:
        """Back to the unloaded sheet; the factor stays."""
        self.moved[:] = 0.0
        self.rotation[:] = np.eye(3)

    def evaluate(self, *, tangent: bool = False) -> float:
        """Energy, J; fills ``internal`` and, when wanted, the tangent."""
        facets = self._facets
        self.evaluations += 1
        self.energy = assemble(
            self.mesh.points,
            self.moved,
            self.rotation,
            self.mesh.triangles,
            facets.frame,
            facets.shape,
            facets.membrane,
            facets.bending,
            self._places,
            tangent,
            self._data,
            self.internal,
        )
        spring = self._edge_spring
        if spring is not None:
            motion = np.zeros((len(self.moved), 6))
            motion[:, :3] = self.moved
            pull = spring * motion.ravel()
            self.internal += pull
            self.energy += 0.5 * float(pull @ motion.ravel())
            if tangent:
                self._data[self._diagonal] += spring[self.free]
        return self.energy

    def tangent(self) -> csc_matrix:
        """Tangent of the free unknowns as evaluated last, per m and per LEVER rad."""
        size = len(self.free)
        return csc_matrix((self._data * self._scale, self._rows, self._starts), shape=(size, size))

    def factor(self) -> Factor:
        """Factor the tangent of the present state, shifted when it is not definite, and keep it for :meth:`solve`.

        Raises
        ------
        IsfError : SHELL_NOT_SOLVED, the tangent is singular or not finite
        """
        self.evaluate(tangent=True)
        self.factorizations += 1
        diagonal = np.abs(self._data[self._diagonal])
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / np.sqrt(diagonal)
        values = (self._data * scale[self._rows] * np.repeat(scale, np.diff(self._starts))).astype(np.float32)
        matrix = csc_matrix((values, self._rows, self._starts), shape=(len(scale), len(scale)))
        unshifted = values[self._diagonal]
        for shift in _SHIFTS if np.isfinite(values).all() else ():
            matrix.data[self._diagonal] = unshifted + np.float32(shift)
            try:
                found = splu(
                    matrix,
                    permc_spec="NATURAL",  # the unknowns stand in elimination order already
                    diag_pivot_thresh=0.0,
                    relax=1,
                    options={"SymmetricMode": True},
                )
            except (RuntimeError, ValueError):
                continue
            self._factor = Factor(found, scale)
            return self._factor
        raise IsfError(
            ErrorCode.SHELL_NOT_SOLVED,
            "the stiffness of the sheet cannot be factored",
            where="shell model",
            advice="the mesh may have facets without area; check the contours and the clamp size",
        )

    @property
    def factor_in_use(self) -> Factor:
        """The factor that :meth:`solve` uses."""
        assert self._factor is not None  # factor() comes first
        return self._factor

    def use_factor(self, factor: Factor) -> None:
        """Solve with a factor made before (of another state, shared by loads and places)."""
        self._factor = factor

    def solve(self, force: Array) -> Array:
        """(F,) m, step of the free unknowns under the residual ``force`` (F,) N, Nm, by the factor in use."""
        return self.factor_in_use.solve(force) / self._unit

    def work(self, force: Array, change: Array) -> float:
        """J, work of ``force`` (F,) N, Nm on the step ``change`` (F,) m of the free unknowns."""
        return float(force @ (change * self._unit))

    def step(self, change: Array) -> None:
        """Move the nodes by the step ``change`` (F,) m of the free unknowns."""
        flat = np.zeros(6 * len(self.moved))
        flat[self.free] = change * self._unit
        motion = flat.reshape(-1, 6)
        self.moved += motion[:, :3]
        turn_nodes(self.rotation, np.ascontiguousarray(motion[:, 3:]))

    def place(self, moved: Array, spins: Array) -> None:
        """Take the state of displacements (N, 3) m and rotation vectors (N, 3) rad."""
        self.moved[:] = moved
        self.rotation[:] = np.eye(3)
        turn_nodes(self.rotation, np.ascontiguousarray(spins))

    def rotation_vectors(self) -> Array:
        """(N, 3) rad, rotation vector of every node."""
        r = self.rotation
        axial = 0.5 * np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)
        sine = np.linalg.norm(axial, axis=1)
        angle = np.arctan2(sine, 0.5 * (np.trace(r, axis1=1, axis2=2) - 1.0))
        return np.asarray(axial * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-300), 1.0)[:, None])


def _elimination_order(triangles: Index, count: int) -> Index:
    """(N,) nodes in an order that keeps the factor sparse: minimum degree on the graph of nodes.

    The six freedoms of a node have the same neighbours, so ordering nodes gives the fill of ordering freedoms at a
    small part of its cost, and once per mesh instead of once per factorization.
    """
    start, end = triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()
    graph = coo_matrix((np.ones(len(start)), (start, end)), shape=(count, count))
    graph = graph + graph.T
    dominant = diags(np.asarray(graph.sum(axis=1)).ravel() + 1.0) - graph
    factor = splu(dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.argsort(factor.perm_c).astype(np.int64)


def held_freedoms(mesh: SheetMesh, edge: EdgeCondition) -> Index:
    """Numbers (6 per node: u, spin) that edge and plate hold; a free edge holds the three rigid modes in its plane."""
    nodes = mesh.edge
    held = [6 * nodes + 2, 6 * mesh.propped + 2]
    if edge.slope == "clamped":
        held += [6 * nodes + 3, 6 * nodes + 4]
    if edge.immovable:
        held += [6 * nodes, 6 * nodes + 1]
        if edge.slope == "clamped":
            held += [6 * nodes + 5]
    elif edge.in_plane == 0.0:
        x, y = mesh.points[nodes, 0], mesh.points[nodes, 1]
        middle = 0.5 * (y.min() + y.max())
        left = nodes[np.argmin(np.hypot(x - x.min(), y - middle))]
        right = nodes[np.argmin(np.hypot(x - x.max(), y - middle))]
        held += [np.array([6 * left, 6 * left + 1, 6 * right + 1])]
    return np.unique(np.concatenate(held))


def edge_springs(mesh: SheetMesh, edge: EdgeCondition) -> Array | None:
    """(6 N,) N/m, spring of every freedom by its share of the edge; None when the edge has none."""
    if edge.immovable or edge.in_plane == 0.0:
        return None
    ring = mesh.points[mesh.edge]
    side = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1)
    share = edge.in_plane * 0.5 * (side + np.roll(side, 1))
    spring = np.zeros((len(mesh.points), 6))
    spring[mesh.edge, 0] = share
    spring[mesh.edge, 1] = share
    return spring.ravel()
