"""A joystick or gamepad (``sensor_msgs/Joy``) as the source of jog messages. Without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from isf_core.errors import ErrorCode, IsfError

from isf_force_ctrl.hand.jog_desk import INCREMENTS, JogDemand, Vector

PUSHED, BACK = 0.6, 0.3
"""Deflection from which an axis counts as pushed, and below which as let go."""

CLIENT = "joy"
"""Who moves the tools."""


@dataclass(frozen=True)
class JoyKeys:
    """Which axes and buttons of the message do what.

    Attributes
    ----------
    axes : of x, y, z, with the sign that makes the deflection point along +
    enable : dead-man's button ; tool, smaller, larger : buttons for the other tool and the next increment
    """

    axes: tuple[tuple[int, float], ...]
    enable: int
    tool: int
    smaller: int
    larger: int

    @staticmethod
    def of(axes: str, enable: int, tool: int, smaller: int, larger: int) -> JoyKeys:
        """``axes`` as text, such as "-1 -0 4"; raises IsfError FILE_FIELD."""
        words = axes.split()
        try:
            numbers = tuple((abs(int(word)), -1.0 if word.startswith("-") else 1.0) for word in words)
        except ValueError:
            numbers = ()
        if len(numbers) != 3:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"'{axes}' does not name three axes",
                where="parameter joy_axes",
                advice='such as "0 1 4", with - before one that is turned round',
            )
        return JoyKeys(numbers, enable, tool, smaller, larger)


class JoyMap:
    """Remembers tool and increment, which buttons change one step per press while the dead-man's button is held."""

    def __init__(self, keys: JoyKeys, speed: float = 0.0) -> None:
        self._keys, self._speed = keys, speed
        self.tool, self._step = 1, INCREMENTS.index(1e-3)
        self._pushed = [0.0, 0.0, 0.0]
        self._down: set[int] = set()

    @property
    def increment(self) -> float:
        """m, chosen; 0: as long as the stick is pushed."""
        return INCREMENTS[self._step]

    def demand(self, axes: Sequence[float], buttons: Sequence[int]) -> JogDemand:
        """What a message asks for; axes and buttons that the device does not have are at rest."""
        keys = self._keys
        down = {k for k in (keys.enable, keys.tool, keys.smaller, keys.larger) if k < len(buttons) and buttons[k]}
        enable, pressed = keys.enable in down, down - self._down
        self._down = down
        if enable:
            self.tool = 3 - self.tool if keys.tool in pressed else self.tool
            change = (keys.larger in pressed) - (keys.smaller in pressed)
            self._step = min(max(self._step + change, 0), len(INCREMENTS) - 1)
        for k, (axis, sign) in enumerate(keys.axes):
            value = sign * axes[axis] if axis < len(axes) else 0.0
            if not abs(value) >= BACK:  # nor a number that is none
                self._pushed[k] = 0.0
            elif abs(value) >= PUSHED:
                self._pushed[k] = 1.0 if value > 0.0 else -1.0
        direction: Vector = (self._pushed[0], self._pushed[1], self._pushed[2])
        return JogDemand(CLIENT, enable, self.tool, direction, self.increment, self._speed)
