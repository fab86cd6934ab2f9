"""Release of contact after a fault: forming tool clear in z, support tool away along the force that it feels."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from isf_sim.machine_sample import MachineSample
from isf_sim.machine_tick import Axes

Array = NDArray[np.float64]

RELEASE_SPEED = 20.0e-3
"""m/s, at which tools are moved clear."""
RELEASE_CLEARANCE = 3.0e-3
"""m, way beyond the loss of contact."""
LARGEST_RELEASE = 25.0e-3
"""m, a release ends here at the latest."""
AT_REST = 1.0e-3
"""m/s"""


def release_steps(
    axes: Axes, travel: Array, control_rate: float, advance: Callable[[Array], MachineSample], pressing: int = 1
) -> Iterator[MachineSample]:
    """The ticks of a release one by one, within ``travel`` (3,) m; ``advance`` makes a tick towards (6,) m.

    ``pressing``: the forming tool, 1 upper, 2 lower.
    """
    push = axes.force_2.copy() if pressing == 1 else axes.force_1.copy()
    clear = np.array([0.0, 0.0, 1.0 if pressing == 1 else -1.0])
    size = float(np.linalg.norm(push))
    away = push / size if size > 1.0 else -clear
    step = RELEASE_SPEED / control_rate * np.concatenate([clear, away] if pressing == 1 else [away, clear])
    limit = np.tile(travel, 2)
    free_way = moved = 0.0
    while free_way < RELEASE_CLEARANCE and moved < LARGEST_RELEASE:
        yield advance(np.clip(axes.target + step, -limit, limit))
        touching = np.abs(axes.force_1).max() > 0.0 or np.abs(axes.force_2).max() > 0.0
        free_way = 0.0 if touching else free_way + RELEASE_SPEED / control_rate
        moved += RELEASE_SPEED / control_rate
    while np.abs(axes.state[:, 1]).max() > AT_REST:
        yield advance(axes.target.copy())
