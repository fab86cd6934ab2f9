"""Position loop of the axes: third order, exact zero-order hold at the servo rate.

G(s) = p wn^2 / ((s + p)(s^2 + 2 zeta wn s + wn^2)) per axis (order and bandwidth: Ren 2018, 2.3.3; damping and
pole ratio assumed). Targets come at the control rate; between two of them the set-point moves on a straight line
(first-order hold), as a motion controller interpolates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import brentq

from isf_sim.jit import kernel

Array = NDArray[np.float64]


class ServoConstants(NamedTuple):
    """Substeps per control tick; transition (3, 3) and input (3,) of one substep for (x, v, a)."""

    substeps: int
    transition: Array
    input: Array


def natural_frequency(bandwidth: float, damping: float, pole_ratio: float) -> float:
    """rad/s, wn for which |G| = -3 dB at ``bandwidth`` Hz, with p = pole_ratio wn."""

    def excess(ratio: float) -> float:
        s = 1j * ratio
        return float(abs(pole_ratio / ((s + pole_ratio) * (s * s + 2.0 * damping * s + 1.0))) - np.sqrt(0.5))

    return float(2.0 * np.pi * bandwidth / brentq(excess, 1e-3, 10.0))


def make_servo(
    bandwidth: float, servo_rate: float, control_rate: float, damping: float, pole_ratio: float
) -> ServoConstants:
    """Constants for the integer multiple of ``control_rate`` (Hz) nearest to ``servo_rate`` (Hz)."""
    substeps = max(1, round(servo_rate / control_rate))
    wn = natural_frequency(bandwidth, damping, pole_ratio)
    p = pole_ratio * wn
    system = np.zeros((4, 4))
    system[0, 1] = system[1, 2] = 1.0
    system[2] = [-p * wn**2, -(wn**2 + 2.0 * damping * wn * p), -(p + 2.0 * damping * wn), p * wn**2]
    discrete = expm(system / (substeps * control_rate))
    return ServoConstants(substeps, np.ascontiguousarray(discrete[:3, :3]), np.ascontiguousarray(discrete[:3, 3]))


@kernel
def follow_targets(axes: Array, start: Array, end: Array, servo: ServoConstants) -> None:
    """Advance ``axes`` (A, 3) by one control tick while the targets move from ``start`` to ``end`` (A,) m."""
    t, b = servo.transition, servo.input
    for step in range(1, servo.substeps + 1):
        share = step / servo.substeps
        for k in range(axes.shape[0]):
            target = start[k] + share * (end[k] - start[k])
            x, v, a = axes[k, 0], axes[k, 1], axes[k, 2]
            for m in range(3):
                axes[k, m] = t[m, 0] * x + t[m, 1] * v + t[m, 2] * a + b[m] * target
