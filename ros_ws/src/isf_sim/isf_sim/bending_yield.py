"""Global bending yield of flange, wall and base under the tool's force.

Where the von Mises equivalent of the bending moments exceeds the yield moment fy sy t^2/4, lowered by the membrane
force N by the factor 1 - (N / (sy t))^2 >= 0.25, the excess curvature stays: it is put on the unloaded sheet as an
eigen-curvature and the sheet takes the shape that follows linearly. The largest ratio seen is remembered, so that
repeated loading does not ratchet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from isf_sim.shell import Shell

Array = NDArray[np.float64]

LARGEST_CHANGE = 1.0e-3
"""m, largest lasting deflection taken from one coarse solution."""


def lasting_deflection(
    shell: Shell,
    state: Array,
    hardened: Array,
    tool: tuple[float, float],
    exclusion: float,
    yield_strength: float,
    yield_factor: float,
) -> Array | None:
    """Change of the unloaded height at the nodes (N,) m, or None when nothing yields.

    ``state`` (N, 3) m deflection under load; ``hardened`` (N,) largest moment ratio so far, updated in place; nodes
    within ``exclusion`` m of ``tool`` (x, y) m are the contact model's business.
    """
    star, xx, yy = shell.stars
    nu, rigidity = shell.elastic.poisson, shell.rigidity
    w = state[:, 2]
    kx, ky = -(xx * w[star]).sum(axis=1), -(yy * w[star]).sum(axis=1)
    kxy = -_twist(shell, w)
    mx, my = rigidity * (kx + nu * ky), rigidity * (ky + nu * kx)
    mxy = rigidity * (1.0 - nu) * kxy
    moment = np.sqrt(mx**2 - mx * my + my**2 + 3.0 * mxy**2)
    t = shell.thickness
    tension = shell.membrane_force(state) / (yield_strength * t)
    limit = yield_factor * yield_strength * t**2 / 4.0 * np.clip(1.0 - tension**2, 0.25, 1.0)
    ratio = moment / limit
    allowed = np.maximum(1.0, hardened)
    far = (shell.node_x - tool[0]) ** 2 + (shell.node_y - tool[1]) ** 2 > exclusion**2
    yields = (ratio > allowed) & far
    if not yields.any():
        return None
    excess = np.where(yields, 1.0 - allowed / np.maximum(ratio, 1e-12), 0.0)
    hardened[yields] = ratio[yields]
    load = np.zeros((shell.count, 3))
    weight = shell.node_area * excess
    for stencil, m in ((xx, weight * mx), (yy, weight * my)):
        load[:, 2] -= np.bincount(star.ravel(), (stencil * m[:, None]).ravel(), shell.count)
    change = shell.linear_response(load)[:, 2]
    return np.clip(change, -LARGEST_CHANGE, LARGEST_CHANGE)


def _twist(shell: Shell, w: Array) -> Array:
    """(N,) 1/m, mixed second difference of w, mean of the cells round each node (no cells beyond the edge)."""
    grid = w.reshape(shell.ny, shell.nx)
    cell = (grid[:-1, :-1] - grid[:-1, 1:] - grid[1:, :-1] + grid[1:, 1:]) / (shell.dx * shell.dy)
    node = np.zeros_like(grid)
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            node[rows, columns] += 0.25 * cell
    return node.ravel()
