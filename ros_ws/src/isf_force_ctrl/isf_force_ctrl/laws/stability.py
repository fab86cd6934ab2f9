"""Stability limits of force and compliance control, computed before a tool moves (Ren 2018, section 2.3.3).

The servo is taken as a third-order Butterworth low-pass of the rig's bandwidth ("third order, 30 Hz"), the contact
as the spring K_c (eq. 2-7, 2-8).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from numpy.typing import NDArray

Complex = NDArray[np.complex128]


MARGIN = 1.5
"""Assumed: so many times the gain is below that at which the loop oscillates."""


def servo_response(bandwidth: float, omega: NDArray[np.float64]) -> Complex:
    """G_m(j omega) of a third-order Butterworth servo; ``bandwidth`` Hz, ``omega`` rad/s."""
    corner = 2 * np.pi * bandwidth
    s = 1j * omega
    return np.asarray(corner**3 / (s**3 + 2 * corner * s**2 + 2 * corner**2 * s + corner**3))


def ultimate_loop_gain(
    bandwidth: float, delay: float = 0.0, compensation: float = 0.0, smoothing_time: float = 0.0
) -> float:
    """1/s, loop gain K_i K_c at which the integral force loop starts to oscillate.

    Parameters
    ----------
    bandwidth : Hz of the servo
    delay : s, filter, transport and hold delays in the force loop
    compensation : K_p K_c of the compliance compensation that acts at the same time; it works as positive
        feedback inside the loop, G_m -> G_m / (1 - K_p K_c H G_m e^(-s delay))
    smoothing_time : s, of H = 1 / (1 + s smoothing_time) in the compensation
    """
    omega = np.linspace(1.0, 4 * np.pi * bandwidth, 8000)
    transport = np.exp(-1j * omega * delay)
    servo = servo_response(bandwidth, omega)
    stiffened = 1 - compensation * servo * transport / (1 + 1j * omega * smoothing_time)
    open_loop = servo * transport / stiffened / (1j * omega)
    phase = np.unwrap(np.angle(open_loop))
    crossing = int(np.argmax(phase <= -np.pi))
    if phase[crossing] > -np.pi:
        return float("inf")
    return float(1.0 / np.abs(open_loop[crossing]))


def check_compliance_gain(
    gain: float, contact_stiffness: float, *, maximum: float = 1.0, where: str = "control.compliance_compensation"
) -> None:
    """Raise UNSTABLE_GAIN unless K_p K_c < ``maximum`` (1: Ren 2018 eq. 2-12).

    ``gain`` m/N, ``contact_stiffness`` N/m; ``where``: field that is at fault.
    """
    product = gain * contact_stiffness
    if product >= maximum:
        raise IsfError(
            ErrorCode.UNSTABLE_GAIN,
            f"compliance compensation of {gain * 1e6:.2f} um/N on a contact of {contact_stiffness * 1e-6:.2f} N/um "
            f"has the loop gain {product:.2f}; it must be below {maximum:g}",
            where=where,
            advice="reduce the factor, or identify compliance and contact stiffness of the rig again",
        )


def check_force_gain(
    loop_gain: float,
    bandwidth: float,
    delay: float,
    compensation: float,
    smoothing_time: float,
    faster: Callable[[], str],
) -> None:
    """Raise UNSTABLE_GAIN unless the integral force loop keeps the gain margin to its limit.

    ``faster`` tells what to do about the delay, for the advice.
    """
    ultimate = ultimate_loop_gain(bandwidth, delay, compensation, smoothing_time)
    if loop_gain * MARGIN > ultimate:
        raise IsfError(
            ErrorCode.UNSTABLE_GAIN,
            f"force loop gain {loop_gain:.0f} 1/s is too close to its stability limit of {ultimate:.0f} 1/s, with a "
            f"servo of {bandwidth:.3g} Hz and {1e3 * delay:.0f} ms of delay",
            where="force control",
            advice=f"set the parameter loop_gain to {math.floor(ultimate / MARGIN)} 1/s or less, {faster()}, or use a "
            "faster servo",
        )
