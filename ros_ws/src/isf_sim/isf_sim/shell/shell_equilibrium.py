"""Equilibrium of the coarse shell: modified Newton with kept factors and Anderson's acceleration.

A factorisation costs as much as some fifteen steps with factors that exist, so the factors of the last solution are
used again; the acceleration mixes the newest steps such that the next one would be smallest. New factors are made only
when the steps left would cost more than they, or mislead. Where the matrix is not positive definite (a sheet about to
buckle) its factors are those of a shifted one, so every step still leads downhill.

A solution is one compiled call: it needs neither the interpreter nor its lock.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

from isf_sim.jit import kernel
from isf_sim.shell.shell_assembly import Pattern, Section, SupportPoints, add_support, assemble
from isf_sim.shell.shell_factor import BandForm, ensure_factors, make_factors, solve_band, symmetric_product

Index = NDArray[np.int32]

LARGEST_STEP = 4.0e-3
"""m, largest change of a displacement in one step."""
LARGEST_ITERATIONS = 120
WINDOW = 8
"""Steps that the acceleration mixes."""
WORTH = 14
"""Steps with existing factors that cost as much as new factors."""
LARGEST_GRADIENT_STEPS = 60


class Problem(NamedTuple):
    """A clamped sheet of n degrees of freedom.

    Attributes
    ----------
    section, pattern, support : what is assembled ; form : the matrix
    springs : (n,) N/m ; diagonal : (n,) places of the diagonal in the matrix values
    place : (n,) where each degree of freedom stands in the flat state (N, 3)
    """

    section: Section
    pattern: Pattern
    support: SupportPoints
    form: BandForm
    springs: Array
    diagonal: Index
    place: NDArray[np.int64]


class Factors(NamedTuple):
    """The kept matrix and its factors, as in shell_factor.KeptFactor and Made; changed in place."""

    values: Array
    band: Array
    of: Array
    shift: Array


class Workspace(NamedTuple):
    """Room for one solution: (N, 3) state, (n + 1,) force, (nnz + 1,) values, (WINDOW, n) differences of states and
    steps."""

    full: Array
    force: Array
    values: Array
    states: Array
    steps: Array


def make_workspace(nodes: int, count: int, entries: int) -> Workspace:
    """Room for ``nodes`` N, ``count`` n and ``entries`` nnz."""
    return Workspace(
        full=np.zeros((nodes, 3)),
        force=np.zeros(count + 1),
        values=np.zeros(entries + 1),
        states=np.zeros((WINDOW, count)),
        steps=np.zeros((WINDOW, count)),
    )


class Work(NamedTuple):
    """Steps and factorisations that it took, and whether it led to equilibrium."""

    iterations: int
    factorisations: int
    converged: bool


@kernel
def out_of_balance(q: Array, load: Array, problem: Problem, tangent: bool, room: Workspace, out: Array) -> float:
    """``out`` (n,) N, load minus inner forces of the state q (n,) m; returns its norm.

    With ``tangent``, ``room.values`` (nnz,) N/m holds the matrix afterwards. Kernels ask for it by ``bool(1)``, not by
    a constant: for each constant numba would compile all that is called from here once more.
    """
    full = room.full.reshape(-1)
    for k in range(len(q)):
        full[problem.place[k]] = q[k]
    assemble(room.full, problem.section, problem.pattern, tangent, room.force, room.values)
    add_support(room.full, problem.support, problem.pattern, tangent, room.force, room.values)
    square = 0.0
    for k in range(len(q)):
        out[k] = load[k] - (room.force[k] + problem.springs[k] * q[k])
        square += out[k] * out[k]
        if tangent:
            room.values[problem.diagonal[k]] += problem.springs[k]
    return np.sqrt(square)


@kernel
def find_equilibrium(
    q: Array, load: Array, tolerance: float, known: bool, problem: Problem, factors: Factors, room: Workspace
) -> Work:
    """Bring the state ``q`` (n,) m to where it is out of balance by less than ``tolerance`` N in norm.

    ``known``: ``factors`` are those of a state near by; otherwise they are made. They are near the state found
    afterwards.
    """
    count = len(q)
    residual, trial_residual, plain, trial = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    last_q, last_plain = np.empty(count), np.empty(count)
    gram = np.zeros((WINDOW, WINDOW))
    size = out_of_balance(q, load, problem, not known, room, residual)
    iterations, factorisations = 0, 0
    if known:
        ensure_factors(factors.values, problem.form, factors.band, factors.of, factors.shift)
    else:
        _renew(problem, factors, room)
        factorisations = 1
    fresh, shrink = factorisations > 0, 1.0
    mixed, following, has_last = 0, 0, False
    begun, first = 0, size
    while size >= tolerance and iterations < LARGEST_ITERATIONS:
        solve_band(factors.band, residual, plain)
        if not np.isfinite(plain).all():
            break
        if shrink == 1.0:
            if has_last:
                room.states[following] = q - last_q
                room.steps[following] = plain - last_plain
                mixed = min(mixed + 1, WINDOW)
                _measure(room.steps, mixed, following, gram)
                following = (following + 1) % WINDOW
            last_q[:], last_plain[:] = q, plain
            has_last = True
            trial[:] = plain
            if mixed > 0:
                _mix(room.states, room.steps, mixed, gram, plain, trial)
        else:
            trial[:] = shrink * plain
        largest = np.abs(trial).max()
        if not np.isfinite(largest):
            break
        trial *= min(1.0, LARGEST_STEP / max(largest, 1e-300))
        trial += q
        trial_size = out_of_balance(trial, load, problem, bool(0), room, trial_residual)
        iterations += 1
        if trial_size < 1.5 * size or (fresh and shrink < 0.1):
            q[:], residual[:], size, shrink = trial, trial_residual, trial_size, 1.0
            done = iterations - begun
            if size < tolerance or done < 5 or _steps_left(size, first, done, tolerance) < WORTH + 5:
                continue
        elif mixed > 0:
            mixed, following, has_last = 0, 0, False
            continue
        elif fresh:
            shrink *= 0.5
            continue
        out_of_balance(q, load, problem, bool(1), room, trial_residual)
        _renew(problem, factors, room)
        factorisations += 1
        fresh = True
        begun, first = iterations, size
        mixed, following, has_last = 0, 0, False
    return Work(iterations, factorisations, size < tolerance)


@kernel
def _renew(problem: Problem, factors: Factors, room: Workspace) -> None:
    factors.values[:] = room.values[:-1]
    make_factors(factors.values, problem.form, factors.band, factors.of, factors.shift)


@kernel
def _steps_left(size: float, first: float, done: int, tolerance: float) -> float:
    """Steps to the tolerance, at the mean rate of those done."""
    if size <= 0.0:
        return 0.0
    rate = np.log(size / first) / done
    return np.log(tolerance / size) / rate if rate < 0.0 else np.inf


@kernel
def _measure(steps: Array, mixed: int, newest: int, gram: Array) -> None:
    """Products of the newest difference of steps with all others."""
    for k in range(mixed):
        gram[k, newest] = gram[newest, k] = np.dot(steps[k], steps[newest])


@kernel
def _mix(states: Array, steps: Array, mixed: int, gram: Array, plain: Array, out: Array) -> None:
    """``out`` (n,) accelerated step, where the plain one is ``plain`` (n,)."""
    norms, right, scaled = np.empty(mixed), np.empty(mixed), np.empty((mixed, mixed))
    for k in range(mixed):
        norms[k] = max(np.sqrt(gram[k, k]), 1e-150)
        right[k] = np.dot(steps[k], plain) / norms[k]
    for k in range(mixed):
        for m in range(mixed):
            scaled[k, m] = gram[k, m] / (norms[k] * norms[m])
        scaled[k, k] += 1e-12
    share = np.linalg.solve(scaled, right) / norms
    for k in range(mixed):
        for m in range(len(out)):
            out[m] -= share[k] * (states[k, m] + steps[k, m])


@kernel
def compliance_at(
    q: Array, load: Array, tolerance: float, problem: Problem, factors: Factors, room: Workspace
) -> tuple[float, int]:
    """load' A^-1 load with the matrix A of the state ``q`` (n,) m, from factors near it; factorisations that it took.

    ``tolerance``: of the response over its load. By conjugate gradients; the factors are made anew where these meet a
    direction without stiffness.
    """
    response, unused = np.zeros(len(q)), np.empty(len(q))
    out_of_balance(q, load, problem, bool(1), room, unused)
    if conjugate_gradients(room.values, problem.form, factors.band, load, tolerance, response):
        return np.dot(load, response), 0
    _renew(problem, factors, room)
    solve_band(factors.band, load, response)
    return np.dot(load, response), 1


@kernel
def conjugate_gradients(values: Array, form: BandForm, band: Array, right: Array, tolerance: float, x: Array) -> bool:
    """x (n,) with A x = ``right`` to ``tolerance`` of its norm, from ``x`` = 0; False where A turns out indefinite.

    Preconditioned by the factors ``band`` of a matrix near A.
    """
    residual, near, image = right.copy(), np.empty_like(right), np.empty_like(right)
    solve_band(band, residual, near)
    direction, energy = near.copy(), np.dot(residual, near)
    bound = tolerance * np.sqrt(np.dot(right, right))
    for _ in range(LARGEST_GRADIENT_STEPS):
        symmetric_product(values, form, direction, image)
        curvature = np.dot(direction, image)
        if curvature <= 0.0:
            return False
        way = energy / curvature
        for k in range(len(x)):
            x[k] += way * direction[k]
            residual[k] -= way * image[k]
        if np.sqrt(np.dot(residual, residual)) < bound:
            return True
        solve_band(band, residual, near)
        before, energy = energy, np.dot(residual, near)
        for k in range(len(x)):
            direction[k] = near[k] + energy / before * direction[k]
    return False


class Room:
    """The workspace of one shell; never part of a state."""

    constant_of_state = True

    def __init__(self, nodes: int, count: int, entries: int) -> None:
        self._sizes = nodes, count, entries
        self.arrays = make_workspace(*self._sizes)

    def __deepcopy__(self, memo: dict[int, Any]) -> Room:
        return Room(*self._sizes)
