"""Are two wrenches believable: finite, within the rig's force limits, alive, and of the right sign?"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from isf_core.errors import ErrorCode

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Mode

Vector = tuple[float, float, float]


_PRESSING = (Mode.ENGAGE, Mode.CONTROL, Mode.POSITION)
"""Modes in which the forming tool is on the sheet."""

_SQUEEZING = (Mode.ENGAGE, Mode.CONTROL)
"""Modes in which the support tool is held in contact."""

_NOTHING = (0.0, 0.0, 0.0)


class WrenchWatch:
    """Watches the wrenches of both tools tick by tick.

    A load cell that works is never still: its noise alone changes a loaded reading from tick to tick, so readings that
    repeat exactly for ``frozen_time`` come from a signal that has frozen; the same reading used again, because no new
    one has come (by the clock), is none. Contacts only push: a forming tool on the
    sheet reads an axial force away from the sheet, and a squeezed support tool a positive normal force. The opposite,
    by more than ``sign_force`` for ``sign_time``, is a cell with a wrong sign; a force loop would push ever harder.
    """

    def __init__(self, config: ControlConfig) -> None:
        self._limit, self._loaded = config.force_limit, config.contact_threshold
        self._frozen_after = config.frozen_time * config.rate
        self._sign_force, self._sign_after = config.sign_force, config.sign_time * config.rate
        self._last: list[Vector] = [_NOTHING, _NOTHING]
        self._used: list[Sequence[float]] = [_NOTHING, _NOTHING]
        self._same, self._against = [0, 0], [0, 0]

    def look(
        self, wrench_1: Sequence[float], wrench_2: Sequence[float], forming: int, mode: Mode, normal_force: float
    ) -> tuple[ErrorCode, str] | None:
        """Code and text of what is wrong with the wrenches (6,) of this tick, None when nothing is.

        ``forming`` is the forming tool (1, 2), ``normal_force`` N that of the support tool.
        """
        if not plausible(wrench_1, wrench_2, self._limit):
            return fault_of(wrench_1, wrench_2, self._limit)
        for index, wrench in ((0, wrench_1), (1, wrench_2)):
            if wrench is self._used[index]:
                continue
            self._used[index] = wrench
            force = (wrench[0], wrench[1], wrench[2])
            if force != self._last[index] or max(map(abs, force)) < self._loaded:
                self._last[index], self._same[index] = force, 0
                continue
            self._same[index] += 1
            if self._same[index] >= self._frozen_after:
                return ErrorCode.WRENCH_FROZEN, (
                    f"tool_{index + 1}/wrench has been the same {self._same[index]} times under load: frozen signal "
                    "(check the load cell's driver)"
                )
        pressing = mode in _PRESSING
        axial = wrench_1[2] if forming == 1 else -wrench_2[2]
        for index, force_of, text in (
            (0, axial if pressing else 0.0, f"the forming tool_{forming} presses on the sheet, but its Fz"),
            (
                1,
                normal_force if mode in _SQUEEZING else 0.0,
                f"the support tool_{3 - forming} is squeezed, but its normal force",
            ),
        ):
            self._against[index] = self._against[index] + 1 if force_of < -self._sign_force else 0
            if self._against[index] > self._sign_after:
                return ErrorCode.LOAD_CELL_SIGN, (
                    f"{text} has the wrong sign ({force_of:.0f} N; a wrench is what the sheet does to the tool, in "
                    "axes of frame sheet)"
                )
        return None


def plausible(wrench_1: Sequence[float], wrench_2: Sequence[float], limit: Vector) -> bool:
    """True when both wrenches (6,) are finite and their forces within ``limit`` (3,) N."""
    x, y, z = limit
    total = float(sum(wrench_1) + sum(wrench_2))
    return bool(
        math.isfinite(total)
        and -x <= wrench_1[0] <= x
        and -y <= wrench_1[1] <= y
        and -z <= wrench_1[2] <= z
        and -x <= wrench_2[0] <= x
        and -y <= wrench_2[1] <= y
        and -z <= wrench_2[2] <= z
    )


def fault_of(wrench_1: Sequence[float], wrench_2: Sequence[float], limit: Vector) -> tuple[ErrorCode, str]:
    """Code and text for wrenches that are not :func:`plausible`."""
    for tool, wrench in ((1, wrench_1), (2, wrench_2)):
        values = np.asarray(wrench, dtype=float)
        if not np.isfinite(values).all():
            return ErrorCode.WRENCH_NOT_FINITE, f"tool_{tool}/wrench is not finite (check the load cell and its cable)"
        beyond = np.abs(values[:3]) > limit
        if beyond.any():
            axis = int(np.argmax(beyond))
            return (
                ErrorCode.WRENCH_OUT_OF_RANGE,
                f"tool_{tool} reads {values[axis]:.0f} N in {'xyz'[axis]}, the rig allows {limit[axis]:.0f} N",
            )
    return ErrorCode.WRENCH_NOT_FINITE, "the sum of the wrenches is not finite"
