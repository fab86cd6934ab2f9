"""What the force controller tells about itself: modes, flags, targets and the state of one tick.

Values and names are those of ``isf_msgs/msg/ForceCtrlState``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

from isf_core.geometry.tool_axis import UPRIGHT

Vector = tuple[float, float, float]


class Mode(IntEnum):
    """What the controller is doing."""

    IDLE = 0
    ARMED = 1
    APPROACH = 2
    ENGAGE = 3
    CONTROL = 4
    POSITION = 5
    FREEZE = 6
    LIFT = 7
    HOLD = 8


class Flag(IntFlag):
    """Limits that were active in a tick."""

    NONE = 0
    SATURATED_ERROR = 1
    SATURATED_RATE = 2
    SATURATED_OFFSET = 4
    SATURATED_COMPLIANCE = 8
    CONTACT_LOST = 16
    OSCILLATION = 32
    DRIFT = 64
    """A load cell read more than ``drift_limit`` when its tool was off the sheet last."""
    PAUSED = 128
    """By the clock: no wrenches in time, the tools stand until they come again."""


SATURATED = 15
"""Sum of the flags that count as saturation; losing contact or oscillating is not one."""


class Targets(NamedTuple):
    """Tips to be reached at the next tick, m in frame ``sheet``, offsets included; height of the blank holder, m; and
    axis of tool 1."""

    tip_1: Vector
    tip_2: Vector
    holder_height: float = 0.0
    axis: Vector = UPRIGHT


@dataclass(frozen=True)
class ControlState:
    """The controller after one tick; fields as in ``isf_msgs/msg/ForceCtrlState``, SI units.

    ``set_point`` and ``error`` are NaN under position control.
    """

    plan_id: str
    index: int
    tick: int
    mode: Mode
    set_point: float
    normal_force: float
    normal_force_filtered: float
    error: float
    forming_offset: Vector
    support_offset: Vector
    contact_stiffness: float
    feed: float
    flags: int
