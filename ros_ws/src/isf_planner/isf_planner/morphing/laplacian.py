"""Laplacian smoothing of a mesh that keeps to its old shape (Behera 2015, Multi-step mesh morphing, eqs. 2-7).

At every vertex the smoothing vector is the mean of its neighbours minus itself (eq. 2, uniform weights), so a smooth
mesh has L X = 0 (eqs. 3, 4). Two ways to go towards it:

* :class:`AnchoredLaplacian`, as published: least squares of L X = 0 and of chi X = chi X0 at anchored vertices (eqs.
  5-7; eq. 6 with one row per anchored vertex). It minimises the square of L X, and overshoots: a part gets deeper and
  steeper in places before it gets flatter.
* :func:`diffused`, our default: (mu D + D - A) X = mu D X0, one implicit step of diffusion. Where L X is minimised
  instead of its square nothing overshoots: every value lies between the largest and the smallest of the old ones.

The source's guidance "chi below 3 is low" holds for few anchors far apart. With all vertices anchored a solve
multiplies a wave for which L has the eigenvalue lambda by chi^2 / (chi^2 + lambda^2), and lambda of a long wave is
small: it falls with the square of the wave's length. So such a chi has to be about as small as lambda to move
anything but ribs.
"""

from __future__ import annotations

import numpy as np
from isf_core.types import Array, Indices, Mask
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu


def uniform(edges: Indices, count: int) -> csr_matrix:
    """(V, V) L of eq. 4 for ``edges`` (E, 2), each once, of ``count`` vertices: 1, and -1 / neighbours at each."""
    ends = np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]])
    joined = csr_matrix((np.ones(len(ends[0])), ends), shape=(count, count))
    neighbours = np.asarray(joined.sum(axis=1)).ravel()
    return csr_matrix(diags((neighbours > 0).astype(float)) - diags(1.0 / np.maximum(neighbours, 1.0)) @ joined)


def grid_edges(shape: tuple[int, int]) -> Indices:
    """(E, 2) edges along x and y between the nodes of a grid, row by row: without diagonals no direction is special."""
    node = np.arange(shape[0] * shape[1]).reshape(shape)
    across = np.column_stack([node[:, :-1].ravel(), node[:, 1:].ravel()])
    return np.vstack([across, np.column_stack([node[:-1].ravel(), node[1:].ravel()])])


class AnchoredLaplacian:
    """Least squares of eqs. 5-7, factorised once for all coordinates and repetitions.

    Parameters
    ----------
    laplacian : (V, V) L
    free : (V,) vertices that move; the others keep their place and stand on the right-hand side
    chi : (V,) weight of every vertex's present place; 0 where it has no anchor
    """

    def __init__(self, laplacian: csr_matrix, free: Mask, chi: Array) -> None:
        self._free = free
        self._own = laplacian[free][:, free]
        self._fixed = laplacian[free][:, ~free]
        self._chi = chi[free]
        self.matrix: csc_matrix = (self._own.T @ self._own + diags(self._chi**2)).tocsc()
        # symmetric and positive definite: SuperLU without pivoting is the Cholesky factor up to the scale of its rows
        self._factor = splu(
            self.matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def right_hand_side(self, vertices: Array) -> Array:
        """(F, C) C^T d of eq. 7 for ``vertices`` (V, C) m and F free ones."""
        pulled = -(self._own.T @ (self._fixed @ vertices[~self._free]))
        return np.asarray(pulled + (self._chi**2)[:, None] * vertices[self._free])

    def apply(self, vertices: Array) -> Array:
        """``vertices`` (V, C) m after one solve of eq. 7."""
        moved = vertices.copy()
        moved[self._free] = self._factor.solve(self.right_hand_side(vertices))
        return moved


def diffused(edges: Indices, free: Mask, mu: Array, values: Array) -> Array:
    """``values`` (V,) after one implicit step of diffusion over the ``edges``; those that are not ``free`` stay.

    ``mu`` (V,) weight of the old value against the mean of the neighbours, positive.
    """
    count = len(values)
    ends = np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]])
    joined = csr_matrix((np.ones(len(ends[0])), ends), shape=(count, count))
    neighbours = np.asarray(joined.sum(axis=1)).ravel()
    matrix = (diags((mu + 1.0) * neighbours) - joined)[free]
    right = (mu * neighbours * values)[free] - matrix[:, ~free] @ values[~free]
    moved = values.copy()
    factor = splu(
        matrix[:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    moved[free] = factor.solve(right)
    return moved
