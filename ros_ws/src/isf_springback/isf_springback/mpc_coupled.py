"""Step depth and horizontal increment in one problem per direction (beyond Lu 2016, named there as future work).

Unknown are the changes u_z (H,) of the planned step depths and the departures D (H,) of the horizontal increments. The
radius error at a fixed plane falls by D and by cot(alpha) times the vertical change; the slope between two contours is
held below the steepest wall, and the sum of the departures within the largest offset.
"""

from __future__ import annotations

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import MpcSpec
from isf_core.types import Array

from isf_springback.mpc_problem import piqp_dense

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
