"""Model-predictive control of contours as small quadratic programs (Lu 2016, 3.2-3.4, errata corrected).

Everything here is numbers: profiles, increments, weights. The model is that neighbouring contours spring back alike,
so that springback cancels in the difference: what was measured moves with the increments of the path.

Vertical, with the profile y (n,) as state (eq. 5-11): zone coefficients B are 0 on the formed wall, rise linearly over
what is being formed, and are 1 on the unformed bottom. The increment u < 0 is the step depth::

    min sum_j |y + sum_(i<=j) B_i u_i - w_j|^2 + weight |u|^2      lower <= u <= upper

Vertical with one bottom point (TPIF, eq. 34-39) is the same with B = 1. Horizontal (eq. 16-22), per direction, with D
the departure from the planned increment and e_j the predicted error of the radius without any::

    min sum_j (e_j + sum_(i<=j) D_i)^2 + weight |D|^2               |D| <= bound

Step depth and horizontal increment in one problem per direction (beyond Lu 2016, named there as future work).

Unknown are the changes u_z (H,) of the planned step depths and the departures D (H,) of the horizontal increments. The
radius error at a fixed plane falls by D and by cot(alpha) times the vertical change; the slope between two contours is
held below the steepest wall, and the sum of the departures within the largest offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import MpcSpec
from isf_core.types import Array
from numpy.typing import NDArray

Solver = Literal["scipy", "piqp"]

_ROUNDS = 40
_GRADIENT_TOLERANCE = 1e-9


@dataclass(frozen=True)
class BoxProblem:
    """M problems min 1/2 x'Px + q'x, lower <= x <= upper; P (M, H, H) or (H, H), q (M, H), bounds scalars or (M, H)."""

    hessian: Array
    gradient: Array
    lower: Array
    upper: Array


def zone_coefficients(reach: Array, contact: float, following: float) -> Array:
    """(n,) zone coefficients between the contacts of two contours: 0 before the first, 1 from the second on.

    The printed eq. 10 has the sign of its denominator wrong (i - c_(k+1) for c_(k+1) - c_k).
    """
    if following - contact <= 1e-9:
        return np.asarray((reach >= contact).astype(float))
    return np.asarray(np.clip((reach - contact) / (following - contact), 0.0, 1.0))


def vertical_problem(
    coefficients: Array, profile: Array, targets: Array, weight: float, lower: float, upper: float
) -> BoxProblem:
    """One vertical problem over H contours and n profile points.

    Parameters
    ----------
    coefficients : (H, n) zone coefficients of every contour ahead
    profile : (n,) m, measured; NaN where unknown (left out)
    targets : (H, n) m, intended profile after each of them
    weight : lambda_z ; lower, upper : m, bounds of the signed increment (negative: downwards)
    """
    known = np.isfinite(profile) & np.isfinite(targets).all(axis=0)
    b, error = coefficients[:, known], profile[known] - targets[:, known]
    horizon = len(b)
    index = np.arange(horizon)
    ahead = horizon - np.maximum(index[:, None], index[None, :])
    hessian = 2.0 * (ahead * (b @ b.T) + weight * np.eye(horizon))
    # q_p = 2 sum_(j >= p) b_p . (y - w_j)
    remaining = np.cumsum(error[::-1], axis=0)[::-1]
    gradient = 2.0 * np.einsum("pn,pn->p", b, remaining)
    bounds = np.ones((1, horizon))
    return BoxProblem(hessian, gradient[None, :], lower * bounds, upper * bounds)


def horizontal_problem(error: Array, weight: float, bound: float) -> BoxProblem:
    """Problems of M directions: ``error`` (M, H) m predicted without departures, |departure| <= ``bound`` m."""
    horizon = error.shape[1]
    chain = np.tril(np.ones((horizon, horizon)))
    hessian = 2.0 * (chain.T @ chain + weight * np.eye(horizon))
    gradient = 2.0 * error @ chain
    bounds = np.full(error.shape, bound)
    return BoxProblem(hessian, gradient, -bounds, bounds)


def scalar_vertical_problem(level: Array, targets: Array, weight: float, lower: float, upper: float) -> BoxProblem:
    """Problems of M bottom points: measured ``level`` (M,) m, ``targets`` (M, H) m per contour ahead (TPIF)."""
    horizon = targets.shape[1]
    chain = np.tril(np.ones((horizon, horizon)))
    hessian = 2.0 * (chain.T @ chain + weight * np.eye(horizon))
    gradient = 2.0 * (level[:, None] - targets) @ chain
    ones = np.ones_like(targets)
    return BoxProblem(hessian, gradient, lower * ones, upper * ones)


def solve(problem: BoxProblem, solver: Solver = "scipy") -> Array:
    """(M, H) minimisers.

    All problems at once by projected Newton steps; those that have not settled, and every single problem, by
    ``scipy.optimize.lsq_linear``, or by PIQP when asked for.

    Raises
    ------
    IsfError : QP_INFEASIBLE (not finite, bounds crossed, Hessian not positive definite), CORRECTION_FAILED (no PIQP)
    """
    _check(problem)
    count, horizon = problem.gradient.shape
    hessian = np.broadcast_to(problem.hessian, (count, horizon, horizon))
    if solver == "piqp":
        return np.array([_by_piqp(hessian[m], problem, m) for m in range(count)])
    if count == 1:
        return _by_scipy(hessian[0], problem, 0)[None, :]
    solution, settled = _projected_newton(hessian, problem)
    for m in np.flatnonzero(~settled):
        solution[m] = _by_scipy(hessian[m], problem, int(m))
    return solution


def _check(problem: BoxProblem) -> None:
    finite = np.isfinite(problem.hessian).all() and np.isfinite(problem.gradient).all()
    if not finite or (problem.lower > problem.upper).any():
        raise IsfError(
            ErrorCode.QP_INFEASIBLE,
            "the problem is not finite" if not finite else "no step satisfies its bounds",
            where="springback.mpc",
            advice="the last good correction is kept; check smallest_step, largest_step, horizontal_change",
        )
    if np.linalg.eigvalsh(problem.hessian).min() <= 0.0:
        raise IsfError(
            ErrorCode.QP_INFEASIBLE,
            "the problem has no unique solution",
            where="springback.mpc",
            advice="use weights above 0; the last good correction is kept",
        )


def _projected_newton(hessian: Array, problem: BoxProblem) -> tuple[Array, NDArray[np.bool_]]:
    """Minimisers (M, H) and whether each satisfies its optimality conditions."""
    lower, upper, q = problem.lower, problem.upper, problem.gradient
    eye = np.eye(hessian.shape[1])
    x = np.clip(-np.linalg.solve(hessian, q[:, :, None])[:, :, 0], lower, upper)
    scale = np.abs(q).max(axis=1, initial=1e-300)
    settled = np.zeros(len(q), dtype=bool)
    for _ in range(_ROUNDS):
        slope = np.einsum("mij,mj->mi", hessian, x) + q
        held = ((x <= lower) & (slope > 0.0)) | ((x >= upper) & (slope < 0.0))
        free = ~held
        settled = np.abs(np.where(free, slope, 0.0)).max(axis=1) <= _GRADIENT_TOLERANCE * scale
        if settled.all():
            break
        reduced = np.where(free[:, :, None] & free[:, None, :], hessian, 0.0) + held[:, :, None] * eye
        step = np.linalg.solve(reduced, np.where(free, slope, 0.0)[:, :, None])[:, :, 0]
        x = np.clip(x - step, lower, upper)
    return x, settled


def _by_scipy(hessian: Array, problem: BoxProblem, m: int) -> Array:
    from scipy.optimize import lsq_linear  # late: only this method needs it

    root = np.linalg.cholesky(hessian).T
    right = -np.linalg.solve(root.T, problem.gradient[m])
    scale = max(float(np.abs(right).max()), 1e-12)
    lower, upper = problem.lower[m] / scale, problem.upper[m] / scale
    if np.all(upper - lower < 1e-12):
        return np.asarray(problem.lower[m])
    found = lsq_linear(root, right / scale, bounds=(lower, upper), method="bvls")
    return np.asarray(found.x * scale)


def _by_piqp(hessian: Array, problem: BoxProblem, m: int) -> Array:
    scale = max(float(np.abs(problem.gradient[m]).max()), 1e-12)
    return scale * piqp_dense(
        hessian, problem.gradient[m] / scale, None, None, problem.lower[m] / scale, problem.upper[m] / scale
    )


def piqp_dense(
    hessian: Array, gradient: Array, rows: Array | None, most: Array | None, lower: Array, upper: Array
) -> Array:
    """Minimiser (H,) by PIQP of 1/2 x'Px + q'x with lower <= x <= upper and ``rows`` x <= ``most``.

    Raises
    ------
    IsfError : CORRECTION_FAILED (PIQP is not installed), QP_INFEASIBLE
    """
    try:
        import piqp
    except ImportError:
        raise IsfError(
            ErrorCode.CORRECTION_FAILED,
            "the solver PIQP is not installed",
            where="springback.mpc.solver",
            advice="pip install piqp, or use solver: scipy",
        ) from None
    program = piqp.DenseSolver()
    program.settings.eps_abs = 1e-9
    program.settings.eps_rel = 1e-9
    n = len(gradient)
    least = None if most is None else np.full(len(most), -np.inf)
    program.setup(
        np.asfortranarray(hessian), gradient, None, None,
        None if rows is None else np.asfortranarray(rows), least, most, lower, upper,
    )  # fmt: skip
    status = program.solve()
    if status != piqp.PIQP_SOLVED:
        raise IsfError(
            ErrorCode.QP_INFEASIBLE,
            f"PIQP ended with {status.name} on {n} unknowns",
            where="springback.mpc",
            advice="the last good correction is kept; widen the bounds",
        )
    return np.asarray(program.result.x)


STEEPER = np.radians(8.0)
"""rad by which the local wall may be steeper than planned (assumed: half of what is left to the usual limit of 65 deg
on a 50 deg wall)."""


def solve_coupled(error: Array, wall_angle: Array, steps: Array, vertical: Array, options: MpcSpec) -> Array:
    """(M,) m, first horizontal departures.

    Parameters
    ----------
    error : (M, H) m, radius errors predicted with planned increments ; wall_angle : (M,) rad
    steps : (H,) m, planned signed step depths ; vertical : (H + 1,) m, vertical errors expected

    Raises
    ------
    IsfError : QP_INFEASIBLE
    """
    horizon = error.shape[1]
    chain = np.tril(np.ones((horizon, horizon)))
    first = np.empty(len(error))
    scale = 1e3
    for m in range(len(error)):
        cot = 1.0 / np.tan(np.clip(wall_angle[m], np.radians(15.0), np.radians(85.0)))
        # errors after the horizon: radius in the plane, and bottom
        rows = np.block([[-cot * chain, chain], [chain, np.zeros_like(chain)]])
        right = -scale * np.concatenate([error[m], np.full(horizon, vertical[-1])])
        weights = np.concatenate(
            [np.full(horizon, options.vertical_weight), np.full(horizon, options.horizontal_weight)]
        )
        hessian = 2.0 * (rows.T @ rows + np.diag(weights))
        gradient = -2.0 * rows.T @ right
        first[m] = _constrained(hessian, gradient, wall_angle[m], scale * steps, options, scale)[horizon] / scale
    return first


def _constrained(hessian: Array, gradient: Array, angle: float, steps: Array, options: MpcSpec, scale: float) -> Array:
    """(2H,) minimiser under bounds, slope and offset limits; lengths in mm."""
    horizon = len(steps)
    planned = np.minimum(steps, -1e-3)
    lower = np.concatenate(
        [planned * (options.largest_step - 1.0), np.full(horizon, -scale * options.horizontal_change)]
    )
    upper = np.concatenate(
        [-planned * (1.0 - options.smallest_step), np.full(horizon, scale * options.horizontal_change)]
    )
    steep = np.tan(min(angle + STEEPER, np.radians(85.0)))
    # |step| <= tan(limit) (|planned increment| - D): -u - tan D-term
    run = -planned / np.tan(max(angle, np.radians(5.0)))
    slope = np.hstack([-np.eye(horizon), steep * np.eye(horizon)])
    slope_most = steep * run + planned
    chain = np.tril(np.ones((horizon, horizon)))
    total = np.hstack([np.zeros_like(chain), chain])
    rows = np.vstack([slope, total, -total])
    most = np.concatenate([slope_most, np.full(2 * horizon, scale * options.largest_offset)])
    if options.solver == "piqp":
        return piqp_dense(hessian, gradient, rows, most, lower, upper)
    from scipy.optimize import LinearConstraint, minimize  # late: only this option needs it

    found = minimize(
        lambda x: 0.5 * x @ hessian @ x + gradient @ x,
        np.zeros(2 * horizon),
        jac=lambda x: hessian @ x + gradient,
        bounds=list(zip(lower, upper, strict=True)),
        constraints=[LinearConstraint(rows, -np.inf, most)],
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 200},
    )
    if not found.success:
        raise IsfError(
            ErrorCode.QP_INFEASIBLE,
            f"no step satisfies slope and bounds: {found.message}",
            where="springback.mpc",
            advice="the last good correction is kept; widen largest_step or horizontal_change",
        )
    return np.asarray(found.x)
