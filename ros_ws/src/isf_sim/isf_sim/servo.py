"""Position loop of the axes: third order, exact zero-order hold at the servo rate.

G(s) = p wn^2 / ((s + p)(s^2 + 2 zeta wn s + wn^2)) per axis (order and bandwidth: Ren 2018, 2.3.3; damping and
pole ratio assumed). Targets come at the control rate; between two of them the set-point moves on a straight line
(first-order hold), as a motion controller interpolates.

Velocity feedforward moves the set-point ahead by its speed times the loop's lag, so that the share asked for of the
following error at constant speed vanishes. A limited following error stands for the saturation of the controller's
output: beyond it the axis is not driven any harder (Ren 2018, 2.2.2: a step saturates the output, a ramp does not).
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
    """Substeps per control tick; transition (3, 3) and input (3,) of one substep for (x, v, a) of the closed loop;
    lead s: feedforward times the loop's lag; limit m: of the following error (infinite: none), and with it the
    transition and input of the open loop that the limited error drives; period s of a substep."""

    substeps: int
    transition: Array
    input: Array
    lead: float
    limit: float
    open_transition: Array
    open_input: Array
    period: float


def natural_frequency(bandwidth: float, damping: float, pole_ratio: float) -> float:
    """rad/s, wn for which |G| = -3 dB at ``bandwidth`` Hz, with p = pole_ratio wn."""

    def excess(ratio: float) -> float:
        s = 1j * ratio
        return float(abs(pole_ratio / ((s + pole_ratio) * (s * s + 2.0 * damping * s + 1.0))) - np.sqrt(0.5))

    return float(2.0 * np.pi * bandwidth / brentq(excess, 1e-3, 10.0))


def make_servo(
    bandwidth: float,
    servo_rate: float,
    control_rate: float,
    damping: float,
    pole_ratio: float,
    *,
    feedforward: float = 0.0,
    limit: float | None = None,
) -> ServoConstants:
    """Constants for the integer multiple of ``control_rate`` (Hz) nearest to ``servo_rate`` (Hz); ``limit`` m."""
    substeps = max(1, round(servo_rate / control_rate))
    wn = natural_frequency(bandwidth, damping, pole_ratio)
    p = pole_ratio * wn
    period = 1.0 / (substeps * control_rate)
    system = np.zeros((4, 4))
    system[0, 1] = system[1, 2] = 1.0
    system[2] = [-p * wn**2, -(wn**2 + 2.0 * damping * wn * p), -(p + 2.0 * damping * wn), p * wn**2]
    closed = expm(system * period)
    system[2, 0] = 0.0  # the position acts through the limited error alone
    driven = expm(system * period)
    return ServoConstants(
        substeps=substeps,
        transition=np.ascontiguousarray(closed[:3, :3]),
        input=np.ascontiguousarray(closed[:3, 3]),
        # the held set-point is half a period ahead already
        lead=feedforward * (1.0 / p + 2.0 * damping / wn - 0.5 * period),
        limit=np.inf if limit is None else limit,
        open_transition=np.ascontiguousarray(driven[:3, :3]),
        open_input=np.ascontiguousarray(driven[:3, 3]),
        period=period,
    )


@kernel
def follow_targets(axes: Array, start: Array, end: Array, servo: ServoConstants) -> int:
    """Advance ``axes`` (A, 3) by one control tick while the targets move from ``start`` to ``end`` (A,) m.

    Returns a bit per axis whose controller saturated.
    """
    saturated = 0
    for k in range(axes.shape[0]):
        ahead = servo.lead * (end[k] - start[k]) / (servo.substeps * servo.period)
        for step in range(1, servo.substeps + 1):
            target = start[k] + step / servo.substeps * (end[k] - start[k]) + ahead
            x, v, a = axes[k, 0], axes[k, 1], axes[k, 2]
            error = target - x
            if servo.limit < np.inf:
                if abs(error) > servo.limit:
                    saturated |= 1 << k
                    error = min(max(error, -servo.limit), servo.limit)
                t, b = servo.open_transition, servo.open_input
                for m in range(3):
                    axes[k, m] = t[m, 0] * x + t[m, 1] * v + t[m, 2] * a + b[m] * error
            else:
                t, b = servo.transition, servo.input
                for m in range(3):
                    axes[k, m] = t[m, 0] * x + t[m, 1] * v + t[m, 2] * a + b[m] * target
    return saturated
