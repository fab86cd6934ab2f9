"""Springback at one point by unloading: the forming tool lifts off while force and height are recorded, and returns.

Ren 2018, section 4.2.2: S = |z(F = 0) - z0|. The support tool, where there is one, is moved away first and back at the
end. Heights are those of the tip: the command as late as the servo follows it, and moved by what the tool gives way
in z under the force. Unloading follows z_0 - z = a F^b with b about 0.57 over the whole way (4.2.4) and 1 at its end: F
runs into zero so gently that a threshold is passed tenths of a millimetre early. So the threshold ends the lift, and
z_0 is that of a curve fitted to the last, small forces.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Targets
from isf_force_ctrl.controller import ForceController
from isf_force_ctrl.measurements.measurement import AtRest, Glide
from isf_force_ctrl.motion.segments import Column, Row

SUPPORT_CLEAR = 2.0e-3
"""m along the sheet's normal, way of the support tool out of contact."""

SETTLING = 0.2
"""s at rest before and after; the force before lifting is the mean of its second half."""

AVERAGE = 0.04
"""s, the force compared with the threshold is the mean over so long."""

FITTED = 6.0
"""Times the threshold: forces up to this are fitted."""

EXPONENT = 0.75
"""b of the fitted curve, assumed: between 0.57 of the whole way and 1 of its end."""

ACCELERATION = 0.05
"""m/s^2 of all moves: a tenth of what a contour may have."""


@dataclass(frozen=True)
class LiftSettings:
    """``speed`` m/s, ``zero_force`` N below which the tool counts as unloaded, ``max_lift`` m."""

    speed: float
    zero_force: float
    max_lift: float


@dataclass(frozen=True)
class LiftRecord:
    """What a lift found.

    Attributes
    ----------
    springback : m, z without force less z before lifting; NaN when the force did not vanish
    force : N, axial force on the forming tool before lifting, support tool away
    lift_z : (K,) m, height of the tip while lifting and returning
    lift_force : (K,) N, axial force at these
    """

    springback: float
    force: float
    lift_z: Array
    lift_force: Array


def lift_tool(controller: ForceController, settings: LiftSettings) -> ToolLift:
    """Begin to measure springback where the tools are; raises IsfError NOT_ARMED."""
    return controller.measure(lambda rest: ToolLift(rest, settings), on_sheet=True)


class ToolLift:
    """A :class:`~isf_force_ctrl.measurements.measurement.Measurement`; begins and ends with the tools on the sheet."""

    keeps_offsets = True

    def __init__(self, rest: AtRest, settings: LiftSettings) -> None:
        """Raises IsfError NOT_ARMED for settings out of range."""
        config, row, tools, normal = rest.config, rest.row, rest.stand.tools, rest.stand.lift_normal
        self.stand = rest.stand
        self._up = 1.0 if tools.forming == 1 else -1.0
        _check(config, settings, row[_z_column(tools.forming)] * self._up)
        self._config, self._settings, self._tools = config, settings, tools
        self._begin, self._away = list(row), -SUPPORT_CLEAR * np.asarray(normal, dtype=float)
        self._axis = 2 if tools.forming == 1 else 5
        self._settling = round(SETTLING * config.rate)
        self._recent: deque[float] = deque(maxlen=max(1, round(AVERAGE * config.rate)))
        self._before: list[float] = []
        self._log: list[tuple[float, float]] = []
        self._turned = 0
        self._waited = 0
        self._lifted = self._out = 0.0
        self._begin_z = row[_z_column(tools.forming)]
        self.code, self.message = ErrorCode.OK, ""
        self.ended = False
        self.phase = ""
        self._enter("support tool away" if tools.with_support else "at rest")

    @property
    def lift(self) -> float:
        """m, present lift."""
        return self._lifted

    @property
    def force(self) -> float:
        """N, present axial force, averaged."""
        return float(np.mean(self._recent)) if self._recent else 0.0

    # -- every tick ----------------------------------------------------------------------------

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """Heights are those commanded."""

    def step(self, time: float, targets: Targets, forces: tuple[float, ...]) -> Row:
        """As in the protocol."""
        axial = self._up * forces[self._axis]
        self._recent.append(axial)
        if self.phase in ("lifting", "returning"):
            self._log.append((self._begin_z + self._up * self._lifted, axial))
        elif self.phase == "at rest":
            self._before.append(axial)
        self._move()
        row = list(self._begin)
        row[_z_column(self._tools.forming)] = self._begin_z + self._up * self._lifted
        support = Column.TIP_2 if self._tools.forming == 1 else Column.TIP_1
        for k in range(3):
            row[support + k] = self._begin[support + k] + self._out * float(self._away[k])
        return row

    def give_up(self, code: ErrorCode, text: str, *, stay: bool) -> None:
        """End early, at rest where the tools are (``stay``), or back at the begin."""
        if self.code is ErrorCode.OK:
            self.code, self.message = code, text
        if stay:
            self._glide.stop()
            if self.phase != "stopping":
                self._enter("stopping")
        elif self.phase in ("support tool away", "at rest", "lifting"):
            self._glide.stop()
            self._turn_back()

    def record(self) -> LiftRecord:
        """What was found; to be called when it has ended."""
        begin, log = self._begin_z, np.array(self._log).reshape(-1, 2)
        force = float(np.mean(self._before[len(self._before) // 2 :])) if self._before else math.nan
        late = round(2.0 / (2.0 * math.pi * self._config.servo_bandwidth) * self._config.rate)
        command = np.concatenate([np.full(late, begin), log[:, 0]])[: len(log)]
        give = self._config.axial_compliance[self._tools.forming - 1] * log[:, 1]
        height = command + self._up * give
        springback = math.nan
        if self.code is ErrorCode.OK:
            start = begin + self._up * self._config.axial_compliance[self._tools.forming - 1] * force
            lifting = slice(0, self._turned)
            rise = self._up * (height[lifting] - start)
            springback = self._up * _zero_of(rise, log[lifting, 1], self._settings.zero_force, self._recent.maxlen or 1)
        return LiftRecord(springback, force, height, self._up * log[:, 1])

    # -- phases --------------------------------------------------------------------------------

    def _enter(self, phase: str) -> None:
        settings, rate = self._settings, self._config.rate
        away = min(settings.speed, self._config.contact_speed)
        if phase in ("support tool away", "support tool back"):
            self._glide = Glide(SUPPORT_CLEAR, away, ACCELERATION, rate)
        elif phase == "lifting":
            self._glide = Glide(settings.max_lift, settings.speed, ACCELERATION, rate)
        elif phase == "returning":
            self._top = self._lifted
            self._turned = len(self._log)
            self._glide = Glide(self._top, settings.speed, ACCELERATION, rate)
        elif phase in ("at rest", "settling"):
            self._glide = Glide(0.0, away, ACCELERATION, rate)
        self._waited = 0
        self._stopped_in = self.phase
        self.phase = phase

    def _move(self) -> None:
        if self.phase in ("at rest", "settling"):
            self._waited += 1
            if self._waited >= self._settling:
                self._after_rest()
            return
        self._place(self._stopped_in if self.phase == "stopping" else self.phase, self._glide.step())
        if self.phase == "lifting":
            self._watch_force()
        if self._glide.at_rest:
            self._arrived()

    def _place(self, phase: str, way: float) -> None:
        if phase == "lifting":
            self._lifted = way
        elif phase == "returning":
            self._lifted = self._top - way
        elif phase == "support tool away":
            self._out = way / SUPPORT_CLEAR
        elif phase == "support tool back":
            self._out = self._out_from * (1.0 - way / SUPPORT_CLEAR)

    def _watch_force(self) -> None:
        full = len(self._recent) == self._recent.maxlen
        if full and self.force < self._settings.zero_force:
            self._glide.stop()

    def _arrived(self) -> None:
        if self.phase == "support tool away":
            if self.code:
                self._turn_back()
            else:
                self._enter("at rest")
        elif self.phase == "lifting":
            if not self.code and self.force >= self._settings.zero_force:
                self.code = ErrorCode.MEASUREMENT_FAILED
                self.message = (
                    f"the force is still {self.force:.0f} N after {1e3 * self._lifted:.2f} mm (raise max_lift, or "
                    "zero_force where the load cell has drifted)"
                )
            elif not self.code and len(self._log) < len(self._recent):
                self.code = ErrorCode.MEASUREMENT_FAILED
                self.message = f"the force was gone after {1e3 * self._lifted:.2f} mm, too soon to tell a springback"
            self._turn_back()
        elif self.phase == "returning":
            self._support_back()
        elif self.phase == "support tool back":
            self._enter("settling")
        elif self.phase == "stopping":
            self.ended = True

    def _turn_back(self) -> None:
        """Wait for rest, then return to the begin."""
        if not self._glide.at_rest:
            return
        if self._lifted > 0.0:
            self._enter("returning")
        else:
            self._support_back()

    def _support_back(self) -> None:
        if self._out > 0.0:
            self._out_from = self._out
            self._enter("support tool back")
        else:
            self._enter("settling")

    def _after_rest(self) -> None:
        if self.phase == "settling":
            self.ended = True
        elif self.code:
            self._turn_back()
        elif self.force < self._settings.zero_force:
            self.code = ErrorCode.MEASUREMENT_FAILED
            self.message = f"the forming tool carries {self.force:.0f} N only: it is not in contact"
            self._turn_back()
        else:
            self._enter("lifting")


def _zero_of(rise: Array, force: Array, zero_force: float, average: int) -> float:
    """m, rise (K,) at which the force (K,) N vanishes, from means over ``average`` ticks of its last, small part; K is
    at least ``average``."""
    blocks = len(rise) // average
    first = len(rise) - blocks * average
    rise = rise[first:].reshape(blocks, average).mean(axis=1)
    force = force[first:].reshape(blocks, average).mean(axis=1)
    small = force <= FITTED * zero_force
    small[: int(np.argmax(small))] = False
    if small.sum() < 4:
        return float(rise[-1])
    columns = np.column_stack([np.ones(small.sum()), -(np.maximum(force[small], 0.0) ** EXPONENT)])
    return float(np.linalg.lstsq(columns, rise[small], rcond=None)[0][0])


def _z_column(tool: int) -> int:
    return int(Column.TIP_1 if tool == 1 else Column.TIP_2) + 2


def _check(config: ControlConfig, settings: LiftSettings, height: float) -> None:
    """Raise IsfError when the lift is not possible."""
    for name, value, most, unit in (
        ("speed", settings.speed, config.contact_speed, "m/s"),
        ("zero_force", settings.zero_force, config.force_limit[2], "N"),
        ("max_lift", settings.max_lift, config.travel[2] - height, "m"),
    ):
        if not 0.0 < value <= most:
            raise IsfError(
                ErrorCode.NOT_ARMED,
                f"{name} of {value:g} {unit} is not possible",
                advice=f"above 0, up to {most:g} {unit}",
            )
