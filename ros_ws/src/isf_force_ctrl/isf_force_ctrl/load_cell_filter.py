"""Low-pass filter of load-cell signals: a short symmetric FIR (Ren 2018, section 2.3.4).

The original filter is [71, 185, 185, 71]/512 at 440 Hz, designed for 40 Hz. Its group delay, 3.4 ms, is what
the stability of the force loop pays for, so the number of taps scales with the rate to keep that delay; such a short
filter passes more than its nominal cut-off, and the integrator behind it does the rest.
"""

from __future__ import annotations

from collections import deque
from operator import mul

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin

ORIGINAL_TAPS = 4
ORIGINAL_RATE = 440.0
"""Hz, update rate for which the original filter has four taps."""


def taps_for(rate: float) -> int:
    """Number of taps with the duration of the original filter at ``rate`` (Hz), 3 or more."""
    return max(3, round(ORIGINAL_TAPS * rate / ORIGINAL_RATE))


def low_pass(cutoff: float, rate: float, taps: int | None = None) -> NDArray[np.float64]:
    """(taps,) coefficients of a Hamming-window low-pass with unit gain at 0 Hz.

    ``cutoff`` Hz and ``rate`` Hz; ``taps`` defaults to :func:`taps_for`. ValueError when the cut-off is not
    below half the rate.
    """
    return np.asarray(firwin(taps or taps_for(rate), cutoff, fs=rate))


def group_delay(taps: int, rate: float) -> float:
    """s, delay of a symmetric FIR."""
    return (taps - 1) / 2.0 / rate


class Fir:
    """A FIR filter fed one sample per tick; starts from rest at ``initial``."""

    __slots__ = ("_coefficients", "_history")

    def __init__(self, coefficients: NDArray[np.float64], initial: float = 0.0) -> None:
        self._coefficients = [float(c) for c in coefficients]
        self._history = deque([initial] * len(self._coefficients), maxlen=len(self._coefficients))

    def step(self, value: float) -> float:
        """Filtered value after taking in ``value``."""
        self._history.appendleft(value)
        return float(sum(map(mul, self._coefficients, self._history)))

    def reset(self, value: float) -> None:
        """Forget the past as if the input had always been ``value``."""
        self._history.extend([value] * len(self._coefficients))
