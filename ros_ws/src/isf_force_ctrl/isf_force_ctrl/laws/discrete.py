"""Coefficients of filters at the control rate.

As scipy.signal has them (firwin, cont2discrete with "foh"), whose import takes longer than all else that the node does
at its start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def windowed_low_pass(taps: int, cutoff: float, rate: float) -> Array:
    """(taps,) coefficients of a Hamming-window low-pass with unit gain at 0 Hz; ``cutoff`` and ``rate`` Hz.

    ValueError when the cut-off is not between 0 and half the rate.
    """
    if not 0.0 < cutoff < 0.5 * rate:
        raise ValueError(f"cut-off {cutoff:g} Hz is not between 0 Hz and half the rate of {rate:g} Hz")
    share = cutoff / (0.5 * rate)
    window = 0.54 + 0.46 * np.cos(np.linspace(-np.pi, np.pi, taps))
    coefficients = share * np.sinc(share * (np.arange(taps) - 0.5 * (taps - 1))) * window
    return np.asarray(coefficients / np.sum(coefficients))


def ramp_invariant(numerator: ArrayLike, denominator: ArrayLike, period: float) -> tuple[Array, Array]:
    """Numerator and denominator, in z, of a transfer function in s whose input goes straight between two samples.

    Highest power first; the numerator is of lower order. ``period`` s of a sample: the triangle hold, as
    cont2discrete has it under "foh".
    """
    above, below = np.atleast_1d(np.asarray(numerator, float)), np.asarray(denominator, float)
    order = len(below) - 1
    output = np.concatenate([np.zeros(order - len(above)), above]) / below[0]
    held = np.zeros((order + 2, order + 2))  # states, input, and its change over the sample
    held[0, :order] = -below[1:] / below[0] * period
    held[1:order, : order - 1] = np.eye(order - 1) * period
    held[0, order] = period
    held[order, order + 1] = 1.0
    moved = _exponential(held)
    system, by_input, by_change = moved[:order, :order], moved[:order, order], moved[:order, order + 1]
    inputs = by_input - by_change + system @ by_change
    through = float(output @ by_change)
    poles = np.real(np.poly(system))
    zeros = np.real(np.poly(system - np.outer(inputs, output)))
    return zeros + (through - 1.0) * poles, poles


def _exponential(matrix: Array) -> Array:
    """Of a small square matrix, by its series and squaring."""
    halvings = max(0, int(np.ceil(np.log2(max(float(np.abs(matrix).sum(axis=0).max()), 1e-300)))) + 2)
    part = matrix / 2.0**halvings
    total = term = np.eye(len(matrix))
    for power in range(1, 19):
        term = term @ part / power
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)
