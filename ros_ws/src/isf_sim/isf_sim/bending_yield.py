"""Global bending yield of flange, wall and base under the tool's force.

Where the von Mises equivalent of the bending moments exceeds the yield moment fy sy t^2/4, lowered by the membrane
force N by the factor 1 - (N / (sy t))^2 >= 0.25, the excess curvature becomes plastic. The elastic strains that are
left stay in the sheet as residual ones, so that unloading and loading again follow the same way. The yield moment
grows with the plastic curvature by a constant part of the bending stiffness (isotropic hardening).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from isf_sim.shell import Shell

Array = NDArray[np.float64]

HARDENING = 0.1
"""Slope of moment over plastic curvature, in bending stiffnesses; assumed. An ideally plastic section still has 0.125
at twice its first yield curvature and 0.04 at three times; hardening of the material adds to it."""
WEAKEST = 0.25
"""Least part of the yield moment that the membrane force leaves."""


def take_plastic_curvature(
    shell: Shell,
    state: Array,
    hardened: Array,
    tool: tuple[float, float],
    exclusion: float,
    yield_strength: float,
    yield_factor: float,
) -> bool:
    """Move the excess curvature under load out of the residual state of ``shell``; False when nothing yields.

    ``state`` (N, 3) m deflection under load; ``hardened`` (N,) N, what hardening has added to the yield moment so
    far, updated in place; nodes within ``exclusion`` m of ``tool`` (x, y) m, under the spread load, are the
    contact model's business. Afterwards the unloaded shape is no longer balanced: see :meth:`Shell.unload`.
    """
    strain = shell.strain(state)
    nu, rigidity = shell.elastic.poisson, shell.rigidity
    kx, ky = strain.bend.T
    kxy = _at_nodes(shell, strain.warp)
    mx, my = rigidity * (kx + nu * ky), rigidity * (ky + nu * kx)
    mxy = rigidity * (1.0 - nu) * kxy
    moment = np.sqrt(mx**2 - mx * my + my**2 + 3.0 * mxy**2)
    t = shell.thickness
    tension = shell.membrane_force(strain) / (yield_strength * t)
    softening = np.clip(1.0 - tension**2, WEAKEST, 1.0)
    limit = yield_factor * yield_strength * t**2 / 4.0 * softening + hardened
    far = (shell.node_x - tool[0]) ** 2 + (shell.node_y - tool[1]) ** 2 > exclusion**2
    over = np.where(far, np.maximum(moment - limit, 0.0), 0.0)
    if not over.any():
        return False
    excess = over / (1.0 + HARDENING) / np.maximum(moment, 1e-12)
    hardened += HARDENING / (1.0 + HARDENING) * over
    shell.residual.bend[...] -= excess[:, None] * strain.bend
    shell.residual.warp[...] -= excess[shell.cells].mean(axis=1) * strain.warp
    return True


def _at_nodes(shell: Shell, cell_values: Array) -> Array:
    """(N,) mean of the values (C,) of the cells round each node, cells beyond the edge counted as zero."""
    return np.asarray(np.bincount(shell.cells.ravel(), np.repeat(0.25 * cell_values, 4), shell.count))
