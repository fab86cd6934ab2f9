"""What the machine tells after a tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class MachineSample(NamedTuple):
    """What the machine tells after a tick.

    Attributes
    ----------
    tick, time : number of the tick and its time, s
    wrench_1, wrench_2 : (6,) N and N m, load cells after tare
    tip_1, tip_2 : (3,) m, tips by the encoders
    true_force_1, true_force_2 : (3,) N, force of the sheet on each tool without errors of the cells
    """

    tick: int
    time: float
    wrench_1: Array
    wrench_2: Array
    tip_1: Array
    tip_2: Array
    true_force_1: Array
    true_force_2: Array
