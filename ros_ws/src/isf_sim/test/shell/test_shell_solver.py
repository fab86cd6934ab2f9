"""Factors and equilibrium iterations of the coarse shell against dense algebra and known minima."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from isf_core.types import Array
from isf_sim.shell.shell import Elastic, Shell
from isf_sim.shell.shell_equilibrium import compliance_at, conjugate_gradients, find_equilibrium, out_of_balance
from isf_sim.shell.shell_factor import (
    BandForm,
    KeptFactor,
    band_form,
    ensure_factors,
    make_factors,
    solve_band,
    symmetric_product,
)
from scipy import sparse


def matrix(count: int = 40, seed: int = 0, shift: float = 0.5) -> sparse.csc_matrix:
    """A symmetric band matrix, positive definite for a positive ``shift``."""
    random = np.random.default_rng(seed)
    lower = sparse.diags([random.standard_normal(count - k) for k in (0, 1, 5)], [0, -1, -5], shape=(count, count))
    full = sparse.csc_matrix(lower @ lower.T + shift * sparse.eye(count))
    full.sort_indices()
    return full


def form_of(full: sparse.csc_matrix) -> BandForm:
    return band_form(full.indices.astype(np.int32), full.indptr.astype(np.int32))


def factors_of(full: sparse.csc_matrix, values: Array | None = None) -> tuple[Array, float]:
    """Band of the factors, and the shift."""
    kept = KeptFactor(form_of(full))
    make_factors(full.data if values is None else values, form_of(full), kept.made.band, kept.made.of, kept.made.shift)
    return kept.made.band, float(kept.made.shift[0])


def solved(band: Array, right: Array) -> Array:
    out = np.empty_like(right)
    solve_band(band, right, out)
    return out


def test_factors_solve_the_system() -> None:
    full = matrix()
    right = np.arange(40.0)
    band, shift = factors_of(full)
    assert shift == 0.0
    assert full @ solved(band, right) == pytest.approx(right, abs=1e-9)


def test_product_is_that_of_the_matrix() -> None:
    full = matrix()
    out = np.empty(40)
    symmetric_product(full.data, form_of(full), np.arange(40.0), out)
    assert out == pytest.approx(full @ np.arange(40.0), rel=1e-12)


def test_indefinite_matrix_gets_a_shift() -> None:
    full = matrix(shift=-0.2)
    assert np.linalg.eigvalsh(full.toarray()).min() < 0.0
    band, shift = factors_of(full)
    assert shift > 0.0
    shifted = full + shift * sparse.diags(np.abs(full.diagonal()))
    right = np.ones(40)
    assert shifted @ solved(band, right) == pytest.approx(right, abs=1e-9)


def test_negative_matrix_has_factors() -> None:
    full = matrix()
    band, _ = factors_of(full, -full.data)
    assert np.isfinite(solved(band, np.ones(40))).all()


def ensured(kept: KeptFactor, form: BandForm, right: Array) -> Array:
    ensure_factors(kept.values, form, kept.made.band, kept.made.of, kept.made.shift)
    return solved(kept.made.band, right)


def test_kept_factors_follow_their_matrix_through_copies() -> None:
    """A copy makes its factors anew from the matrix, with the same bits; renewing the copy leaves the original."""
    full = matrix()
    form = form_of(full)
    kept = KeptFactor(form)
    right = np.linspace(-1.0, 1.0, 40)
    kept.values[...] = full.data
    first = ensured(kept, form, right)
    other = copy.deepcopy(kept)
    assert np.isnan(other.made.of).all()
    assert (ensured(other, form, right) == first).all()
    other.values *= 2.0
    assert ensured(other, form, right) == pytest.approx(0.5 * first)
    assert (ensured(kept, form, right) == first).all()


def test_conjugate_gradients_with_factors_of_a_matrix_near_by() -> None:
    full, near = matrix(), matrix(shift=0.7)
    right, x = np.ones(40), np.zeros(40)
    band, _ = factors_of(near)
    assert conjugate_gradients(full.data, form_of(full), band, right, 1e-9, x)
    assert full @ x == pytest.approx(right, abs=1e-7)
    indefinite = matrix(shift=-0.2)
    assert not conjugate_gradients(indefinite.data, form_of(indefinite), band, right, 1e-9, np.zeros(40))


SHEET = (0.25, 0.25), 0.25 / 20, Elastic(70e9, 0.33), 1e-3


def loaded(shell: Shell, x: float, force: float) -> tuple[Array, Array]:
    """State at rest and load, (n,) each."""
    load = (shell.load_patch(x, 0.01, 5e-3)[:, None] * np.array([0.0, 0.0, force])).ravel()[shell.problem().place]
    return np.zeros(len(load)), load


@pytest.mark.parametrize("before", [None, -100.0, -700.0])
def test_equilibrium_is_one_whatever_the_factors(before: float | None) -> None:
    """Factors made anew and those of another load lead to the state in which the sheet carries the load."""
    shell = Shell(*SHEET)
    if before is not None:
        shell.solve(shell.load_patch(0.03, 0.01, 5e-3), np.array([0.0, 0.0, before]))
    problem, factors, room = shell.problem(), shell.factors(), shell._room.arrays
    q, load = loaded(shell, 0.02, -400.0)
    work = find_equilibrium(q, load, 1e-6, before is not None, problem, factors, room)
    assert work.converged
    assert work.factorisations >= (0 if before else 1)
    left = np.empty_like(q)
    assert out_of_balance(q, load, problem, False, room, left) < 1e-6
    fresh = Shell(*SHEET)
    other, _ = loaded(fresh, 0.02, -400.0)
    find_equilibrium(other, load, 1e-6, False, fresh.problem(), fresh.factors(), fresh._room.arrays)
    assert q == pytest.approx(other, abs=1e-9)


def test_load_that_is_not_finite_is_reported_as_not_converged() -> None:
    shell = Shell(*SHEET)
    q, load = loaded(shell, 0.0, np.nan)
    work = find_equilibrium(q, load, 1e-3, False, shell.problem(), shell.factors(), shell._room.arrays)
    assert not work.converged
    assert (q == 0.0).all()


def test_load_that_no_sheet_carries_ends_the_search() -> None:
    """1 MN tears any sheet of 1 mm; what counts is an end, told as not converged."""
    shell = Shell(*SHEET)
    q, load = loaded(shell, 0.0, -1e9)
    work = find_equilibrium(q, load, 1e-3, False, shell.problem(), shell.factors(), shell._room.arrays)
    assert not work.converged
    assert np.isfinite(q).all()


def test_compliance_where_the_kept_factors_mislead() -> None:
    """A sheet pushed until its matrix is indefinite along the load: the factors are made anew, the answer is finite."""
    shell = Shell(*SHEET)
    q, load = loaded(shell, 0.0, 1.0)
    problem, factors, room = shell.problem(), shell.factors(), shell._room.arrays
    find_equilibrium(q, load, 1e-6, False, problem, factors, room)
    q[np.abs(q) < 1e-5] -= 3e-3  # crumpled in its plane
    response, made = compliance_at(q, load, 1e-2, problem, factors, room)
    assert made in (0, 1)
    assert np.isfinite(response)


def test_kept_factors_change_a_deflection_by_less_than_its_tolerance() -> None:
    """A shell that has solved other loads before, and a fresh one, agree to the residual's tolerance of 1e-5."""
    used, fresh = Shell(*SHEET), Shell(*SHEET)
    for x, force in ((0.04, -100.0), (-0.03, -700.0)):
        used.solve(used.load_patch(x, 0.01, 5e-3), np.array([0.0, 0.0, force]))
    patch, load = used.load_patch(0.02, 0.02, 5e-3), np.array([30.0, 0.0, -400.0])
    one, other = used.solve(patch, load), fresh.solve(patch, load)
    assert one.displacement == pytest.approx(other.displacement, abs=2e-5 * 5e-3)
    assert one.axial_compliance == pytest.approx(other.axial_compliance, rel=1e-3)
