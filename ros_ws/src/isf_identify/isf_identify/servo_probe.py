"""Response of the position loop: one tool follows a small chirp on each axis in free air, lifted clear of the sheet.

The amplitude falls with the frequency, so that the acceleration stays within that of ordinary moves; what the machine
reports (``tool_k/pose``) is compared with what was commanded by :func:`fit_servo`, however seldom it reports: the model
is fitted to the reports at their own times, so the chirp may be faster than they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.measurements.measurement import AtRest, Probe, Program
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, least_squares
from scipy.signal import cont2discrete, lfilter

from isf_identify.settings import IdentifySettings

DURATION = 4.0
"""s of the chirp on each axis."""

BEGIN, END = 0.07, 2.0
"""Frequencies of the chirp over the bandwidth that the rig file tells."""

AMPLITUDE = 0.1e-3
"""m, largest."""

ACCELERATION = 0.8
"""Of the acceleration that the tools may have."""

MINIMUM_POSES = 60
"""Reports per axis."""

MAXIMUM_RESIDUAL = 0.05
"""Of the reported motion (rms): a greater one is another system than the model."""

_FAILED_ADVICE = "check that the machine publishes tool_1/pose and tool_2/pose, and follows its targets"


class ServoProbe(Probe):
    """Collects commands and reports of one tool; :attr:`commands` and :attr:`reports` per axis."""

    def __init__(self, rest: AtRest, settings: IdentifySettings, *, both_tools: bool = True) -> None:
        super().__init__(rest, both_tools=both_tools)
        self.settings = settings
        self.commands: list[list[tuple[float, float]]] = [[], [], []]
        """(time s, m) per axis; the time is when the command is to be reached."""
        self.reports: list[list[tuple[float, float]]] = [[], [], []]
        """(time s, m) per axis."""
        self._axis = -1

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """Keep a report of the axis that moves."""
        if tool == self.settings.tool and self._axis >= 0:
            self.reports[self._axis].append((time, float(tip[self._axis])))

    def watch(self) -> None:
        """Nothing to watch: the tools are in free air, and the wrenches are checked by the controller."""

    def program(self) -> Program:
        """A chirp on x, y and z, ``repeats`` times."""
        chirp = chirp_way(self.config)
        count = 3 * self.settings.repeats
        for number in range(count):
            axis = number % 3
            self.progress = number / count
            self.phase = f"chirp on {'xyz'[axis]} of tool_{self.settings.tool}"
            yield from self.rest(0.3)
            self._axis = axis
            start = list(self.row)
            column = 3 * (self.settings.tool - 1) + axis
            for way in chirp:
                row = list(start)
                row[column] += way
                self.commands[axis].append((self.time + 1.0 / self.config.rate, row[column]))
                yield row
            self._axis = -1
        self.progress = 1.0


def chirp_way(config: ControlConfig) -> list[float]:
    """m from rest to rest, one per tick; frequency rises exponentially."""
    time = np.arange(round(DURATION * config.rate)) / config.rate
    low, high = BEGIN * config.servo_bandwidth, min(END * config.servo_bandwidth, 0.2 * config.rate)
    growth = np.log(high / low) / DURATION
    frequency = low * np.exp(growth * time)
    phase = 2.0 * np.pi * low * np.expm1(growth * time) / growth
    most = ACCELERATION * config.acceleration / (2.0 * np.pi * frequency) ** 2
    fade = np.minimum(1.0, np.minimum(time, DURATION - time) / 0.25)
    fade = fade**2 * (3.0 - 2.0 * fade)
    way: list[float] = (np.minimum(0.7 * AMPLITUDE, 0.7 * most) * fade * np.sin(phase)).tolist()
    return way


@dataclass(frozen=True)
class ServoFit:
    """-3 dB ``bandwidth`` Hz and ``delay`` s with standard deviations; ``residual`` over the motion (rms).

    ``per_axis`` (3,) Hz; ``time``, ``command``, ``report``, ``fitted`` (K,) of one axis, s and m, for a picture.
    """

    bandwidth: float
    bandwidth_deviation: float
    delay: float
    delay_deviation: float
    residual: float
    per_axis: Array
    time: Array
    command: Array
    report: Array
    fitted: Array


def fit_servo(probe: ServoProbe, rate: float, guess: float) -> ServoFit:
    """Third-order model (Ren 2018, 2.3.3) with a delay, fitted per axis; ``rate`` Hz, ``guess`` Hz of the bandwidth.

    Raises IsfError MEASUREMENT_FAILED.
    """
    found = []
    for axis in range(3):
        commands, reports = np.array(probe.commands[axis]), np.array(probe.reports[axis]).reshape(-1, 2)
        if len(reports) < MINIMUM_POSES:
            raise _failed(f"the machine reported {len(reports)} poses during a chirp, {MINIMUM_POSES} are needed")
        found.append(_fit_axis(commands, reports, rate, guess))
    bandwidth = np.array([item[0] for item in found])
    own = np.array([item[1] for item in found])
    delay = np.array([item[2] for item in found])
    residual = max(item[4] for item in found)
    if residual > MAXIMUM_RESIDUAL:
        raise _failed(f"{100 * residual:.0f} % of the motion are not those of a third-order loop with a delay")
    time, command, report, fitted = found[0][5]
    return ServoFit(
        float(bandwidth.mean()),
        float(np.hypot(bandwidth.std(ddof=1), np.sqrt((own**2).mean()))),
        float(delay.mean()),
        float(np.hypot(delay.std(ddof=1), np.sqrt(np.mean([item[3] ** 2 for item in found])))),
        residual,
        bandwidth,
        time,
        command,
        report,
        fitted,
    )


def _fit_axis(
    commands: Array, reports: Array, rate: float, guess: float
) -> tuple[float, float, float, float, float, tuple[Array, Array, Array, Array]]:
    """Bandwidth, its deviation, delay, its deviation, share not explained, and the curves of one axis."""
    begin = commands[0, 1]
    grid = np.arange(round((commands[-1, 0] - commands[0, 0]) * rate) + 1) / rate + commands[0, 0]
    command = np.interp(grid, commands[:, 0], commands[:, 1]) - begin
    inside = (reports[:, 0] >= grid[0]) & (reports[:, 0] <= grid[-1])
    time, report = reports[inside, 0], reports[inside, 1] - begin

    def response(parameters: Array) -> Array:
        natural, damping, ratio = np.exp(parameters[:3])
        motion = _motion(command, float(natural), float(damping), float(ratio), rate)
        moved: Array = CubicSpline(grid, motion)(np.clip(time - parameters[3] / guess, grid[0], grid[-1]))
        return moved

    start = np.array([np.log(2.0 * np.pi * guess), np.log(0.7), 0.0, 0.0])
    size = float(np.sqrt((report**2).mean())) + 1e-12
    limits = (
        [start[0] - 2.5, np.log(0.2), np.log(0.3), -1.0 * guess / rate],
        [start[0] + 2.5, np.log(2.0), np.log(20.0), 0.1 * guess],
    )
    best = least_squares(lambda p: (response(p) - report) / size, start, bounds=limits, diff_step=1e-5)
    misfit = best.fun * size
    residual = float(np.sqrt((misfit**2).sum() / max(1, len(report) - 4)))
    covariance = (residual / size) ** 2 * np.linalg.pinv(best.jac.T @ best.jac)
    bandwidth = _bandwidth(best.x)
    slope = np.zeros(4)
    for k in range(3):
        moved = best.x.copy()
        moved[k] += 1e-4
        slope[k] = (_bandwidth(moved) - bandwidth) / 1e-4
    deviation = float(np.sqrt(slope @ covariance @ slope))
    delay_deviation = float(np.sqrt(covariance[3, 3])) / guess
    curves = (time - grid[0], np.interp(time, grid, command), report, response(best.x))
    return bandwidth, deviation, float(best.x[3]) / guess, delay_deviation, residual / size, curves


def _motion(command: Array, natural: float, damping: float, ratio: float, rate: float) -> Array:
    """Response of p wn^2 / ((s + p)(s^2 + 2 zeta wn s + wn^2)), p = ``ratio`` wn, to a command joined by lines."""
    pole = ratio * natural
    below = np.polymul([1.0, pole], [1.0, 2.0 * damping * natural, natural**2])
    upper, lower, _ = cont2discrete(([pole * natural**2], below), 1.0 / rate, method="foh")
    motion: Array = lfilter(np.ravel(upper), lower, command)
    return motion


def _bandwidth(parameters: Array) -> float:
    """Hz, -3 dB."""
    natural, damping, ratio = np.exp(parameters[:3])

    def excess(w: float) -> float:
        s = 1j * w
        return float(abs(ratio / ((s + ratio) * (s * s + 2.0 * damping * s + 1.0))) - np.sqrt(0.5))

    return float(natural * brentq(excess, 1e-3, 30.0) / (2.0 * np.pi))


def _failed(what: str) -> IsfError:
    return IsfError(ErrorCode.MEASUREMENT_FAILED, what, where="identify", advice=_FAILED_ADVICE)
