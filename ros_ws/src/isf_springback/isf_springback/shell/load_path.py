"""A rising load at one node: displacement of that node at every load level, with few factorizations.

Each level starts from an extrapolation of the states before it in F^b and is brought to equilibrium by chord steps
with the factor at hand, accelerated after Anderson (1965); the tangent is factored anew only where the steps shrink
too slowly or are too long. The factor of the unloaded sheet is shared by all loads on one mesh. There is no arc
length: a sheet that snaps through is not followed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU

from isf_springback.shell.sheet_model import ShellModel

Array = NDArray[np.float64]


_RIDGE = 1e-10
"""Part of the diagonal added to the normal equations of the mixing, which may be nearly singular."""


_CAREFUL = 0.5
"""Contraction asked for in small steps."""

_STEPS = 24
"""Small steps after which a load is given up."""


@dataclass(frozen=True)
class PathOptions:
    """How a load path is followed.

    Attributes
    ----------
    tolerance : m, largest last step of any unknown (spins at a lever of 1 mm)
    memory : steps kept for Anderson's acceleration
    contraction : a step longer than this part of the one before asks for a new factor
    longest : m, longest step taken; a longer one also asks for a new factor
    iterations : steps per load level after which the path is given up
    """

    tolerance: float = 1e-6
    memory: int = 10
    contraction: float = 1.0
    longest: float = 2.5e-3
    iterations: int = 60


@dataclass
class _State:
    load: float
    moved: Array
    spins: Array


def follow_load(
    model: ShellModel,
    node: int,
    direction: Array,
    loads: Array,
    unloaded_factor: SuperLU,
    options: PathOptions = PathOptions(),
) -> Array:
    """(L, 3) m, displacement of ``node`` under the rising ``loads`` (L,) N along the unit vector ``direction`` (3,).

    Raises
    ------
    IsfError : SHELL_NOT_SOLVED, no equilibrium found at a level
    """
    unit = np.zeros(6 * len(model.moved))
    unit[6 * node : 6 * node + 3] = direction
    unit = unit[model.free]
    model.reset()
    model.use_factor(unloaded_factor)
    states: list[_State] = []
    result = np.empty((len(loads), 3))
    for level, load in enumerate(loads):
        if states:
            _extrapolate(model, states, float(load))
        if not _equilibrium(model, float(load) * unit, options):
            _in_small_steps(model, states, float(load), unit, options)
        states.append(_State(float(load), model.moved.copy(), model.rotation_vectors()))
        result[level] = model.moved[node]
    return result


def _in_small_steps(model: ShellModel, states: list[_State], load: float, unit: Array, options: PathOptions) -> None:
    """Bring the model to ``load`` from the last state in ever smaller steps, with a new factor at each slow one."""
    careful = replace(options, contraction=_CAREFUL)
    reached = states[-1].load if states else 0.0
    done = [*states]
    step = 0.5 * (load - reached)
    for _ in range(_STEPS):
        target = min(reached + step, load)
        if done:
            model.place(done[-1].moved, done[-1].spins)
        else:
            model.reset()
        model.factor()
        if _equilibrium(model, target * unit, careful):
            if target >= load:
                return
            reached = target
            done.append(_State(target, model.moved.copy(), model.rotation_vectors()))
        else:
            step *= 0.5
    raise IsfError(
        ErrorCode.SHELL_NOT_SOLVED,
        f"no equilibrium of the sheet between {reached:.0f} and {load:.0f} N",
        where="shell model",
        advice="it may snap through under this load; lower the largest load of the samples",
    )


def _extrapolate(model: ShellModel, states: list[_State], load: float) -> None:
    """State at ``load`` by the polynomial in F^b through the last three states, the unloaded one counting as one."""
    last = states[-1]
    if len(states) == 1:
        share = (load / last.load) ** 0.6
        model.place(share * last.moved, share * last.spins)
        return
    before = states[-2]
    growth = np.log(np.linalg.norm(last.moved) / np.linalg.norm(before.moved)) / np.log(last.load / before.load)
    exponent = float(np.clip(growth, 0.35, 1.0))
    known = states[-3:]
    places = np.array([state.load**exponent for state in known])
    target = load**exponent
    if len(known) == 2:
        places = np.concatenate([[0.0], places])
    weights = [
        np.prod([(target - other) / (place - other) for j, other in enumerate(places) if j != i])
        for i, place in enumerate(places)
    ][-len(known) :]
    moved = sum((w * s.moved for w, s in zip(weights, known, strict=True)), np.zeros_like(last.moved))
    spins = sum((w * s.spins for w, s in zip(weights, known, strict=True)), np.zeros_like(last.spins))
    model.place(moved, spins)


def _equilibrium(model: ShellModel, force: Array, options: PathOptions) -> bool:
    """Iterate from the present state; False when that leads nowhere."""
    steps: list[Array] = []
    residuals: list[Array] = []
    before = np.inf
    fresh = False
    for _ in range(options.iterations):
        model.evaluate()
        residual = model.solve(force - model.internal[model.free])
        largest = float(np.abs(residual).max())
        if not np.isfinite(largest):
            break
        if largest < options.tolerance:
            model.step(residual)
            return True
        size = float(np.linalg.norm(residual))
        if not fresh and (size > options.contraction * before or largest > 1.2 * options.longest):
            model.factor()
            fresh, steps, residuals = True, [], []
            residual = model.solve(force - model.internal[model.free])
            size = float(np.linalg.norm(residual))
        else:
            fresh = False
        step = _accelerated(residual, steps, residuals, options.memory)
        longest = float(np.abs(step).max())
        if longest > options.longest:
            step = step * (options.longest / longest)
        model.step(step)
        steps.append(step)
        residuals.append(residual)
        before = size
    return False


def _accelerated(residual: Array, steps: list[Array], residuals: list[Array], memory: int) -> Array:
    """Anderson's mixing of the last steps; ``steps`` were taken with ``residuals`` known before them."""
    count = min(memory, len(steps))
    if count == 0:
        return residual
    sequence = [*residuals[-count:], residual]
    changes = np.stack([after - earlier for earlier, after in pairwise(sequence)])
    gram = changes @ changes.T
    gram[np.diag_indices(count)] *= 1.0 + _RIDGE
    share = np.linalg.solve(gram, changes @ residual)
    return np.asarray(residual - share @ (np.stack(steps[-count:]) + changes))
