"""Factors and equilibrium iterations of the coarse shell against dense algebra and known minima."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from isf_sim.shell import Elastic, Shell
from isf_sim.shell_equilibrium import conjugate_gradients, find_equilibrium
from isf_sim.shell_factor import BandForm, KeptFactor
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]


def matrix(count: int = 40, seed: int = 0, shift: float = 0.5) -> sparse.csc_matrix:
    """A symmetric band matrix, positive definite for a positive ``shift``."""
    random = np.random.default_rng(seed)
    lower = sparse.diags([random.standard_normal(count - k) for k in (0, 1, 5)], [0, -1, -5], shape=(count, count))
    full = sparse.csc_matrix(lower @ lower.T + shift * sparse.eye(count))
    full.sort_indices()
    return full


def form_of(full: sparse.csc_matrix) -> BandForm:
    return BandForm(full.indices.astype(np.int32), full.indptr.astype(np.int32))


def test_factors_solve_the_system() -> None:
    full = matrix()
    right = np.arange(40.0)
    factor = form_of(full).factorise(full.data)
    assert factor.shift == 0.0
    assert full @ factor.solve(right) == pytest.approx(right, abs=1e-9)


def test_indefinite_matrix_gets_a_shift() -> None:
    full = matrix(shift=-0.2)
    assert np.linalg.eigvalsh(full.toarray()).min() < 0.0
    factor = form_of(full).factorise(full.data)
    assert factor.shift > 0.0
    shifted = full + factor.shift * sparse.diags(np.abs(full.diagonal()))
    right = np.ones(40)
    assert shifted @ factor.solve(right) == pytest.approx(right, abs=1e-9)


def test_negative_matrix_and_forces_that_are_not_finite_stop_nothing() -> None:
    """Factors exist always; a residual of NaN ends the search, told as not converged."""
    full = matrix()
    form = form_of(full)
    factor = form.factorise(-full.data)
    assert np.isfinite(factor.solve(np.ones(40))).all()
    found = find_equilibrium(np.zeros(40), factor, lambda x: np.full(40, np.nan), lambda x: factor, 1e-9)
    assert not found.converged


def test_kept_factors_follow_their_matrix_through_copies() -> None:
    """A copy makes its factors anew from the matrix, with the same bits; renewing the copy leaves the original."""
    full = matrix()
    kept = KeptFactor(form_of(full), full.nnz)
    assert kept.get() is None
    right = np.linspace(-1.0, 1.0, 40)
    first = kept.renew(full.data).solve(right)
    other = copy.deepcopy(kept)
    again = other.get()
    assert again is not None
    assert (again.solve(right) == first).all()
    other.renew(2.0 * full.data)
    mine = kept.get()
    assert mine is not None
    assert (mine.solve(right) == first).all()
    kept.drop()
    assert kept.get() is None


def test_conjugate_gradients_with_factors_of_a_matrix_near_by() -> None:
    full, near = matrix(), matrix(shift=0.7)
    right = np.ones(40)
    x = conjugate_gradients(lambda v: full @ v, form_of(near).factorise(near.data), right, 1e-9)
    assert x is not None
    assert full @ x == pytest.approx(right, abs=1e-7)
    indefinite = matrix(shift=-0.2)
    assert conjugate_gradients(lambda v: indefinite @ v, form_of(near).factorise(near.data), right, 1e-9) is None


def test_equilibrium_with_old_factors_agrees_with_newton() -> None:
    """Minimum of x'Ax/2 + sum x^4/4 - b'x: factors of A and those made where needed lead to the same place."""
    full = matrix()
    form, right = form_of(full), 3.0 * np.ones(40) * 1e-3

    def residual(x: Array) -> Array:
        return np.asarray(right - full @ x - 1e4 * x**3)

    old = form.factorise(matrix(shift=0.8).data)
    slow = find_equilibrium(np.zeros(40), old, residual, lambda x: old, 1e-12)
    newton = find_equilibrium(
        np.zeros(40),
        None,
        residual,
        lambda x: form.factorise((full + sparse.diags(3e4 * x**2)).tocsc().data),
        1e-12,
    )
    assert slow.converged
    assert newton.converged
    assert newton.factorisations >= 1
    assert slow.q == pytest.approx(newton.q, abs=1e-10)


def test_equilibrium_gives_up_without_a_solution() -> None:
    full = matrix()
    factor = form_of(full).factorise(full.data)
    found = find_equilibrium(
        np.zeros(40), factor, lambda x: np.full(40, 1.0 + float(np.abs(x).max())), lambda x: factor, 1e-9
    )
    assert not found.converged


def test_kept_factors_change_a_deflection_by_less_than_its_tolerance() -> None:
    """A shell that has solved other loads before, and a fresh one, agree to the residual's tolerance of 1e-5."""
    sheet = (0.25, 0.25), 0.25 / 20, Elastic(70e9, 0.33), 1e-3
    used, fresh = Shell(*sheet), Shell(*sheet)
    for x, force in ((0.04, -100.0), (-0.03, -700.0)):
        used.solve(used.load_patch(x, 0.01, 5e-3), np.array([0.0, 0.0, force]))
    patch, load = used.load_patch(0.02, 0.02, 5e-3), np.array([30.0, 0.0, -400.0])
    one, other = used.solve(patch, load), fresh.solve(patch, load)
    assert one.displacement == pytest.approx(other.displacement, abs=2e-5 * 5e-3)
    assert one.axial_compliance == pytest.approx(other.axial_compliance, rel=1e-3)
