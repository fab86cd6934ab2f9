"""Equilibrium of the coarse shell: modified Newton with kept factors and Anderson's acceleration.

A factorisation costs as much as some fifteen steps with factors that exist, so the factors of the last solution are
used again; the acceleration mixes the newest steps such that the next one would be smallest. New factors are made only
when the steps left would cost more than they, or mislead. Where the matrix is not positive definite (a sheet about to
buckle) its factors are those of a shifted one, so every step still leads downhill.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from isf_sim.shell_factor import Factor

Array = NDArray[np.float64]

LARGEST_STEP = 4.0e-3
"""m, largest change of a displacement in one step."""
LARGEST_ITERATIONS = 120
WINDOW = 8
"""Steps that the acceleration mixes."""
WORTH = 14
"""Steps with existing factors that cost as much as new factors."""


class Equilibrium(NamedTuple):
    """State (n,) m, factors of a matrix near it, work done."""

    q: Array
    factor: Factor
    iterations: int
    factorisations: int
    converged: bool


def find_equilibrium(
    q: Array,
    factor: Factor | None,
    residual_at: Callable[[Array], Array],
    factor_at: Callable[[Array], Factor],
    tolerance: float,
) -> Equilibrium:
    """State (n,) m whose out-of-balance force ``residual_at`` is below ``tolerance`` N in norm, from the state ``q``.

    ``factor``: of a matrix of a state near by, None without; ``factor_at``: makes those of a state.
    """
    residual = residual_at(q)
    size = float(np.linalg.norm(residual))
    factorisations, iterations = 0, 0
    if factor is None:
        factor, factorisations = factor_at(q), 1
    fresh, shrink = factorisations > 0, 1.0
    mixing = _Mixing(len(q))
    begun, first = 0, size
    while size >= tolerance and iterations < LARGEST_ITERATIONS:
        plain = factor.solve(residual)
        step = shrink * mixing.step(q, plain) if shrink == 1.0 else shrink * plain
        largest = float(np.abs(step).max())
        if not np.isfinite(largest):
            break
        if largest > LARGEST_STEP:
            step *= LARGEST_STEP / largest
        trial = q + step
        trial_residual = residual_at(trial)
        trial_size = float(np.linalg.norm(trial_residual))
        iterations += 1
        if trial_size < 1.5 * size or (fresh and shrink < 0.1):
            q, residual, size, shrink = trial, trial_residual, trial_size, 1.0
            done = iterations - begun
            rate = np.log(size / first) / done if size > 0.0 else -np.inf
            left = np.log(tolerance / size) / rate if rate < 0.0 else np.inf
            if size < tolerance or done < 5 or left < WORTH + 5:
                continue
        elif mixing.count > 0:
            mixing.clear()
            continue
        elif fresh:
            shrink *= 0.5
            continue
        factor = factor_at(q)
        factorisations += 1
        fresh = True
        begun, first = iterations, size
        mixing.clear()
    return Equilibrium(q, factor, iterations, factorisations, size < tolerance)


class _Mixing:
    """Anderson's acceleration: the newest differences of states and of plain steps."""

    def __init__(self, size: int) -> None:
        self.count = 0
        self._last: tuple[Array, Array] | None = None
        self._states, self._steps = np.zeros((WINDOW, size)), np.zeros((WINDOW, size))
        self._gram = np.zeros((WINDOW, WINDOW))
        self._next = 0

    def clear(self) -> None:
        """Forget everything."""
        self.count, self._next, self._last = 0, 0, None

    def step(self, q: Array, plain: Array) -> Array:
        """(n,) accelerated step from ``q`` (n,), where the plain one is ``plain`` (n,)."""
        last, self._last = self._last, (q, plain)
        if last is None:
            return plain
        k = self._next
        np.subtract(q, last[0], out=self._states[k])
        np.subtract(plain, last[1], out=self._steps[k])
        self._next, self.count = (k + 1) % WINDOW, min(self.count + 1, WINDOW)
        steps, states, gram = self._steps[: self.count], self._states[: self.count], self._gram
        gram[k, : self.count] = gram[: self.count, k] = steps @ steps[k]
        norms = np.sqrt(np.diag(gram)[: self.count]) + 1e-300
        scaled = gram[: self.count, : self.count] / np.outer(norms, norms) + 1e-12 * np.eye(self.count)
        share = np.linalg.solve(scaled, steps @ plain / norms) / norms
        return np.asarray(plain - share @ states - share @ steps)


def conjugate_gradients(
    product: Callable[[Array], Array], factor: Factor, right: Array, tolerance: float
) -> Array | None:
    """(n,) x with A x = ``right`` to ``tolerance`` of its norm, preconditioned; None where A turns out indefinite."""
    x = np.zeros_like(right)
    residual = right.copy()
    near = factor.solve(residual)
    direction, energy = near, float(residual @ near)
    bound = tolerance * float(np.linalg.norm(right))
    for _ in range(60):
        image = product(direction)
        curvature = float(direction @ image)
        if curvature <= 0.0:
            return None
        x = x + energy / curvature * direction
        residual = residual - energy / curvature * image
        if float(np.linalg.norm(residual)) < bound:
            return x
        near = factor.solve(residual)
        before, energy = energy, float(residual @ near)
        direction = near + energy / before * direction
    return None
