"""On-line estimate of the contact stiffness K_c (Ren 2018 eq. 2-8) for the gain K_i = loop_gain / K_c.

Recursive least squares with forgetting on changes of the normal force over changes of the support tool's offset, the
latter passed through the servo's model (third order, section 2.3.3) and the force's filter. In closed loop the offset
answers disturbances, and such data would tell of the controller instead of the contact; so the estimate takes in only
ticks in which the *set-point* moves the offset, with contact. Guards: least excitation, bounds around the rig's value.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.signal import cont2discrete

from isf_force_ctrl.load_cell_filter import Fir

WINDOW = 0.04
"""s over which changes are taken."""

MEMORY = 0.5
"""s of excited ticks that are remembered."""

LEAST_EXCITATION = 20.0e-6
"""m, change of the offset over the window (root of the sum of squares) that the start value is worth."""

BOUNDS = (0.3, 3.0)
"""Bounds of the estimate, as factors on the rig's contact stiffness."""


class StiffnessEstimate:
    """Contact stiffness (N/m); one call per tick. ``nominal`` N/m, ``rate`` and ``bandwidth`` Hz."""

    def __init__(self, nominal: float, rate: float, bandwidth: float, fir: Fir) -> None:
        corner = 2 * np.pi * bandwidth
        continuous = ([corner**3], [1.0, 2 * corner, 2 * corner**2, corner**3])
        numerator, denominator, _ = cont2discrete(continuous, 1.0 / rate, method="foh")
        self._b: list[float] = np.ravel(numerator).tolist()
        self._a: list[float] = np.ravel(denominator).tolist()[1:]
        self._inputs = deque([0.0] * len(self._b), maxlen=len(self._b))
        self._outputs = deque([0.0] * 3, maxlen=3)
        self._fir = fir
        ticks = max(2, round(WINDOW * rate))
        self._history: deque[tuple[float, float]] = deque(maxlen=ticks + 1)
        self._forget = 1.0 - 1.0 / (MEMORY * rate)
        self._nominal = nominal
        self._low, self._high = BOUNDS[0] * nominal, BOUNDS[1] * nominal
        self._den = LEAST_EXCITATION**2
        self._num = nominal * self._den
        self._still = ticks
        self._ticks = ticks
        self.value = nominal
        """N/m, present estimate."""

    def step(self, offset: float, force: float, *, moving: bool) -> float:
        """Estimate after one tick with ``offset`` (m, towards the forming tool) and filtered normal ``force`` (N).

        ``moving``: the set-point is being changed, with contact.
        """
        self._inputs.appendleft(offset)
        position = sum(b * u for b, u in zip(self._b, self._inputs, strict=True))
        position -= sum(a * y for a, y in zip(self._a, self._outputs, strict=True))
        self._outputs.appendleft(position)
        self._history.append((self._fir.step(position), force))
        self._still = 0 if moving else self._still + 1
        if self._still >= self._ticks or len(self._history) <= self._ticks:
            return self.value
        moved = self._history[-1][0] - self._history[0][0]
        pressed = self._history[-1][1] - self._history[0][1]
        self._den = self._forget * self._den + moved * moved
        self._num = self._forget * self._num + moved * pressed
        if self._den > 0.25 * LEAST_EXCITATION**2:
            self.value = min(max(self._num / self._den, self._low), self._high)
        return self.value
