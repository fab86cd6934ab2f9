"""A rising load at one node after the other: displacement of that node at every load level, with few factorizations.

The first level starts on the line of the linear answer where the potential energy is least, each later one from an
extrapolation of the states before it in F^b. From there chord steps with the factor at hand, accelerated after
Anderson (1965), lead to equilibrium; the tangent is factored anew only where the steps left would cost more than that,
or lead away. Factors serve all nodes of a mesh: the sheet under the same load elsewhere is about as stiff. There is no
arc length: a sheet that snaps through is not followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from scipy.optimize import minimize_scalar

from isf_springback.shell.sheet_model import Factor, ShellModel

_RIDGE = 1e-10
"""Part of the diagonal added to the normal equations of the mixing, which may be nearly singular."""

_CAREFUL = 0.5
"""Contraction asked for in small steps."""

_STEPS = 24
"""Small steps after which a load is given up."""

_JUDGED = 4
"""Steps with one factor after which their number to the end is estimated."""


@dataclass(frozen=True)
class PathOptions:
    """How a load path is followed.

    Attributes
    ----------
    tolerance : m, largest last step of any unknown (spins at a lever of 1 mm)
    memory : steps kept for Anderson's acceleration
    contraction : a step longer than this multiple of the one before asks for a new factor
    worth : steps that cost as much as a new factor: more of them left ask for one
    longest : m, longest step taken; a longer one also asks for a new factor
    iterations : steps per load level after which the path is given up
    """

    tolerance: float = 5e-7
    memory: int = 10
    contraction: float = 2.0
    worth: int = 16
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
    unloaded_factor: Factor,
    options: PathOptions = PathOptions(),
) -> Array:
    """(L, 3) m, displacement of ``node`` under the rising ``loads`` (L,) N along the unit vector ``direction`` (3,).

    Raises
    ------
    IsfError : SHELL_NOT_SOLVED, no equilibrium found at a level
    """
    return follow_loads(model, [node], direction, loads, unloaded_factor, options)[0]


def follow_loads(
    model: ShellModel,
    nodes: Sequence[int],
    direction: Array,
    loads: Array,
    unloaded_factor: Factor,
    options: PathOptions = PathOptions(),
) -> Array:
    """(M, L, 3) m, displacement of each of ``nodes`` when it alone is loaded as in :func:`follow_load`.

    direction : (3,) or (M, 3), of all loads or of each

    Raises
    ------
    IsfError : SHELL_NOT_SOLVED, no equilibrium found at a level
    """
    kept: list[Factor] = []
    result = np.empty((len(nodes), len(loads), 3))
    for row, (node, along) in enumerate(zip(nodes, np.broadcast_to(direction, (len(nodes), 3)), strict=True)):
        result[row] = _follow(model, int(node), along, loads, unloaded_factor, kept, options)
    return result


def _follow(
    model: ShellModel,
    node: int,
    direction: Array,
    loads: Array,
    unloaded_factor: Factor,
    kept: list[Factor],
    options: PathOptions,
) -> Array:
    """(L, 3) m; ``kept``: newest factor of every level, filled and renewed here."""
    unit = np.zeros(6 * len(model.moved))
    unit[6 * node : 6 * node + 3] = direction
    unit = unit[model.free]
    model.reset()
    model.use_factor(unloaded_factor)
    states: list[_State] = []
    result = np.empty((len(loads), 3))
    for level, load in enumerate(loads):
        if level < len(kept):
            model.use_factor(kept[level])
        if states:
            _extrapolate(model, states, float(load))
        else:
            _begin(model, float(load) * unit)
            if not kept:
                model.factor()
        if not _equilibrium(model, float(load) * unit, options):
            _in_small_steps(model, states, float(load), unit, options)
        kept[level : level + 1] = [model.factor_in_use]
        states.append(_State(float(load), model.moved.copy(), model.rotation_vectors()))
        result[level] = model.moved[node]
    return result


def _begin(model: ShellModel, force: Array) -> None:
    """Put the unloaded ``model`` where on the line of its linear answer to ``force`` the potential energy is least.

    A sheet is far stiffer than its first tangent says; the whole linear answer would lie far outside.
    """
    answer = model.solve(force)
    work = model.work(force, answer)

    def potential(share: float) -> float:
        model.reset()
        model.step(share * answer)
        return (model.evaluate() - share * work) / work

    if not np.isfinite(work) or work <= 0.0:
        return
    found = minimize_scalar(potential, bounds=(0.0, 3.0), method="bounded", options={"xatol": 0.05})
    potential(float(found.x))


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
    mixing = _Mixing(options.memory, len(force))
    sizes: list[float] = []
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
        sizes.append(float(np.linalg.norm(residual)))
        fresh = not fresh and (largest > 1.2 * options.longest or _misleads(sizes, largest, options))
        if fresh:
            model.factor()
            mixing = _Mixing(options.memory, len(force))
            residual = model.solve(force - model.internal[model.free])
            sizes = [float(np.linalg.norm(residual))]
        step = mixing.step(residual)
        longest = float(np.abs(step).max())
        if longest > options.longest:
            step = step * (options.longest / longest)
        model.step(step)
        mixing.take(step)
    return False


def _misleads(sizes: list[float], largest: float, options: PathOptions) -> bool:
    """Whether a new factor is worth its cost; ``sizes``: of the steps with the one in use, ``largest``: m, the last."""
    done = len(sizes) - 1
    if done and sizes[-1] > options.contraction * sizes[-2]:
        return True
    if done < _JUDGED:
        return False
    rate = np.log(sizes[0] / sizes[-1]) / done
    return bool(np.log(largest / options.tolerance) > rate * options.worth)


class _Mixing:
    """Anderson's acceleration: the last steps and what they changed of the step still asked for."""

    def __init__(self, memory: int, size: int) -> None:
        self._memory = memory
        self._count = 0
        self._sums, self._changes = np.empty((memory, size)), np.empty((memory, size))
        self._gram = np.zeros((memory, memory))
        self._residual: Array | None = None
        self._step: Array | None = None

    def step(self, residual: Array) -> Array:
        """(F,) m, the step to take where the factor alone asks for ``residual`` (F,) m."""
        if self._step is not None and self._residual is not None and self._memory:
            k = self._count % self._memory
            np.subtract(residual, self._residual, out=self._changes[k])
            np.add(self._step, self._changes[k], out=self._sums[k])
            self._count += 1
            filled = min(self._count, self._memory)
            self._gram[k, :filled] = self._gram[:filled, k] = self._changes[:filled] @ self._changes[k]
        self._residual = residual
        filled = min(self._count, self._memory)
        if filled == 0:
            return residual
        gram = self._gram[:filled, :filled] + np.diag(_RIDGE * np.diag(self._gram)[:filled])
        share = np.linalg.solve(gram, self._changes[:filled] @ residual)
        return np.asarray(residual - share @ self._sums[:filled])

    def take(self, step: Array) -> None:
        """Remember the step that was taken."""
        self._step = step
