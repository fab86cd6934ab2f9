"""Moves that are not forming: approach from park, links between contours, lift-off and park.

All are straight moves of both tools together, from rest to rest, in the order that keeps the tools off the sheet:
traverse at park height, then down (tool_1) and up (tool_2) onto the sheet, the last stretch slowly. Lifting moves
the support tool away along the sheet's normal first, then both vertically clear. The blank holder of TPIF moves while
the tools are clear, or along with a link.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from isf_core.geometry.tool_axis import UP
from isf_core.types import Array

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.motion.trajectory import Limits, Motion, sample, straight

_UP = (1.0, -1.0)
"""Direction of z in which tool 1 and tool 2 are clear of the sheet."""


@dataclass(frozen=True)
class Posture:
    """Where both tools are: tips (3,) m and the angle of d_n, rad; height of the blank holder, m; axis of tool 1."""

    tip_1: Array
    tip_2: Array
    angle: float
    holder: float = 0.0
    axis: Array = field(default_factory=UP.copy)


@dataclass(frozen=True)
class Tools:
    """Who takes part: the forming tool (1, 2), and whether the other one moves as well."""

    forming: int = 1
    with_support: bool = True

    def moves(self, tool: int) -> bool:
        """True when ``tool`` (1, 2) takes part."""
        return self.with_support or tool == self.forming


def limits_of(config: ControlConfig) -> Limits:
    """Motion limits of a configuration."""
    return Limits(config.rate, config.acceleration, config.blend_time, config.jerk_time, config.tilt_lever)


def move(config: ControlConfig, start: Posture, end: Posture, speed: float, forming: int = 1) -> Motion:
    """Straight move of both tools at no more than ``speed`` m/s of the faster one."""
    path = straight(
        np.array([start.tip_1, end.tip_1]),
        np.array([start.tip_2, end.tip_2]),
        (start.angle, end.angle),
        config.offset_limit,
        forming=forming,
        holder=(start.holder, end.holder),
        axis=(start.axis, end.axis),
        axis_arm=speed / config.axis_rate,
    )
    first = float(np.linalg.norm(end.tip_1 - start.tip_1))
    second = float(np.linalg.norm(end.tip_2 - start.tip_2))
    if forming == 2:
        first, second = second, first
    if second > first:
        speed *= max(first, 0.5 * second) / second
    return sample(path, speed, limits_of(config))


def approach(config: ControlConfig, here: Posture, start: Posture, feed: float, tools: Tools) -> list[Motion]:
    """From anywhere clear of the sheet to the first point of a contour: retract, traverse, descend, touch.

    A tool that takes no part stays where it is. Tool 1 is tilted while it traverses.
    """
    high = _raised(config, here, tools)
    over = _with_heights(start, here, tools, (high.tip_1[2], high.tip_2[2]))
    near = _with_heights(
        start,
        here,
        tools,
        (
            min(high.tip_1[2], start.tip_1[2] + config.clearance),
            max(high.tip_2[2], start.tip_2[2] - config.clearance),
        ),
    )
    rapid = config.rapid_speed
    legs = [(here, high, rapid), (high, over, rapid), (over, near, rapid)]
    return _moves(config, [*legs, (near, start, min(feed, config.contact_speed))], tools)


def link(config: ControlConfig, here: Posture, start: Posture, feed: float, tools: Tools) -> Motion | None:
    """Short straight move to the next contour with the tools in contact; None when it would be too long."""
    longest = max(np.linalg.norm(start.tip_1 - here.tip_1), np.linalg.norm(start.tip_2 - here.tip_2))
    if longest > config.link_length:
        return None
    return move(config, here, start, feed, tools.forming)


def lift(config: ControlConfig, here: Posture, normal: Array, tools: Tools) -> list[Motion]:
    """Both tools clear of the sheet: support away along ``normal`` (3,), forming away in z, then to park height."""
    tips = []
    for tool, tip in ((1, here.tip_1), (2, here.tip_2)):
        if tool == tools.forming:
            tips.append(tip + np.array([0.0, 0.0, _UP[tool - 1] * config.clearance]))
        else:
            tips.append(tip - config.clearance * normal if tools.with_support else tip)
    away = replace(here, tip_1=tips[0], tip_2=tips[1])
    high = _raised(config, away, tools)
    return _moves(config, [(here, away, config.contact_speed), (away, high, config.rapid_speed)], tools)


def park(config: ControlConfig, here: Posture, tools: Tools) -> list[Motion]:
    """From park height to the park position x = y = 0, upright; the blank holder comes down."""
    end = Posture(
        np.array([0.0, 0.0, here.tip_1[2]]) if tools.moves(1) else here.tip_1,
        np.array([0.0, 0.0, here.tip_2[2]]) if tools.moves(2) else here.tip_2,
        here.angle,
    )
    return _moves(config, [(here, end, config.rapid_speed)], tools)


def aside(config: ControlConfig, here: Posture, tools: Tools) -> list[Motion]:
    """From anywhere clear of the sheet to where the tools wait during a scan; the blank holder stays."""
    x, y = config.aside
    high = _raised(config, here, tools)
    end = replace(
        here,
        tip_1=np.array([x, y, high.tip_1[2]]) if tools.moves(1) else here.tip_1,
        tip_2=np.array([x, y, high.tip_2[2]]) if tools.moves(2) else here.tip_2,
    )
    return _moves(config, [(here, high, config.rapid_speed), (high, end, config.rapid_speed)], tools)


def brake(config: ControlConfig, here: Posture, velocity: tuple[Array, Array], forming: int = 1) -> Motion:
    """Straight on from ``here`` with the ``velocity`` (3,), (3,) m/s of both tips, down to rest.

    For a path that ended in motion and is not continued; ``forming`` is the forming tool.
    """
    fastest = max(float(np.linalg.norm(velocity[0])), float(np.linalg.norm(velocity[1])))
    ticks = max(2, int(np.ceil(2.0 * fastest / config.acceleration * config.rate)))
    time = np.arange(ticks + 1) / config.rate
    way = (time - time**2 / (2 * time[-1]))[:, None]
    count = len(time)
    normal = np.tile([np.cos(here.angle), np.sin(here.angle)], (count, 1))
    nothing = np.full(count, np.nan)
    speed = float(np.linalg.norm(velocity[forming - 1])) * (1 - time / time[-1])
    return Motion(
        here.tip_1 + way * velocity[0],
        here.tip_2 + way * velocity[1],
        normal,
        nothing,
        nothing,
        speed,
        np.full(count, here.holder),
        np.empty((0, 3)) if np.array_equal(here.axis, UP) else np.tile(here.axis, (count, 1)),
    )


def _raised(config: ControlConfig, here: Posture, tools: Tools) -> Posture:
    return replace(
        here,
        tip_1=_with_height(here.tip_1, max(config.park_height, here.tip_1[2])) if tools.moves(1) else here.tip_1,
        tip_2=_with_height(here.tip_2, min(-config.park_height, here.tip_2[2])) if tools.moves(2) else here.tip_2,
    )


def _with_heights(start: Posture, here: Posture, tools: Tools, heights: tuple[float, float]) -> Posture:
    """``start`` with the tips at ``heights`` (m); a tool that takes no part is where it is ``here``."""
    return replace(
        start,
        tip_1=_with_height(start.tip_1, heights[0]) if tools.moves(1) else here.tip_1,
        tip_2=_with_height(start.tip_2, heights[1]) if tools.moves(2) else here.tip_2,
    )


def _with_height(tip: Array, height: float) -> Array:
    return np.array([tip[0], tip[1], height])


def _moves(config: ControlConfig, legs: list[tuple[Posture, Posture, float]], tools: Tools) -> list[Motion]:
    return [move(config, start, end, speed, tools.forming) for start, end, speed in legs if _differs(start, end)]


def _differs(start: Posture, end: Posture) -> bool:
    apart = np.abs(end.tip_1 - start.tip_1).max() + np.abs(end.tip_2 - start.tip_2).max()
    turns = start.angle != end.angle or start.holder != end.holder or not np.array_equal(start.axis, end.axis)
    return bool(apart > 1e-9 or turns)
