"""Moves that are not forming: approach from park, links between contours, lift-off and park.

All are straight moves of both tools together, from rest to rest, in the order that keeps the tools off the sheet:
traverse at park height, then down (tool_1) and up (tool_2) onto the sheet, the last stretch slowly. Lifting moves
the support tool away along the sheet's normal first, then both vertically clear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.trajectory import Limits, Motion, sample, straight

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Posture:
    """Where both tools are: tips (3,) m and the angle of d_n, rad."""

    tip_1: Array
    tip_2: Array
    angle: float


def limits_of(config: ControlConfig) -> Limits:
    """Motion limits of a configuration."""
    return Limits(config.rate, config.acceleration, config.blend_time, config.jerk_time)


def move(config: ControlConfig, start: Posture, end: Posture, speed: float) -> Motion:
    """Straight move of both tools at no more than ``speed`` m/s of the faster one."""
    path = straight(
        np.array([start.tip_1, end.tip_1]),
        np.array([start.tip_2, end.tip_2]),
        (start.angle, end.angle),
        config.offset_limit,
    )
    first = float(np.linalg.norm(end.tip_1 - start.tip_1))
    second = float(np.linalg.norm(end.tip_2 - start.tip_2))
    if second > first:
        speed *= max(first, 0.5 * second) / second
    return sample(path, speed, limits_of(config))


def approach(config: ControlConfig, here: Posture, start: Posture, feed: float, *, with_support: bool) -> list[Motion]:
    """From anywhere clear of the sheet to the first point of a contour: retract, traverse, descend, touch.

    Without a support tool tool_2 stays where it is.
    """
    high = _raised(config, here, with_support)
    over = Posture(
        _with_height(start.tip_1, high.tip_1[2]),
        _with_height(start.tip_2, high.tip_2[2]) if with_support else here.tip_2,
        start.angle,
    )
    near_1 = min(high.tip_1[2], start.tip_1[2] + config.clearance)
    near_2 = max(high.tip_2[2], start.tip_2[2] - config.clearance)
    near = Posture(
        _with_height(start.tip_1, near_1),
        _with_height(start.tip_2, near_2) if with_support else here.tip_2,
        start.angle,
    )
    rapid = config.rapid_speed
    legs = [(here, high, rapid), (high, over, rapid), (over, near, rapid)]
    return _moves(config, [*legs, (near, start, min(feed, config.contact_speed))])


def link(config: ControlConfig, here: Posture, start: Posture, feed: float) -> Motion | None:
    """Short straight move to the next contour with the tools in contact; None when it would be too long."""
    longest = max(np.linalg.norm(start.tip_1 - here.tip_1), np.linalg.norm(start.tip_2 - here.tip_2))
    if longest > config.link_length:
        return None
    return move(config, here, start, feed)


def lift(config: ControlConfig, here: Posture, normal: Array, *, with_support: bool) -> list[Motion]:
    """Both tools clear of the sheet: support away along ``normal`` (3,), forming up, then both to park height."""
    away = Posture(
        here.tip_1 + np.array([0.0, 0.0, config.clearance]),
        here.tip_2 - config.clearance * normal if with_support else here.tip_2,
        here.angle,
    )
    high = _raised(config, away, with_support)
    return _moves(config, [(here, away, config.contact_speed), (away, high, config.rapid_speed)])


def park(config: ControlConfig, here: Posture, *, with_support: bool) -> list[Motion]:
    """From park height to the park position x = y = 0."""
    end = Posture(
        np.array([0.0, 0.0, here.tip_1[2]]),
        np.array([0.0, 0.0, here.tip_2[2]]) if with_support else here.tip_2,
        here.angle,
    )
    return _moves(config, [(here, end, config.rapid_speed)])


def _raised(config: ControlConfig, here: Posture, with_support: bool) -> Posture:
    return Posture(
        _with_height(here.tip_1, max(config.park_height, here.tip_1[2])),
        _with_height(here.tip_2, min(-config.park_height, here.tip_2[2])) if with_support else here.tip_2,
        here.angle,
    )


def _with_height(tip: Array, height: float) -> Array:
    return np.array([tip[0], tip[1], height])


def _moves(config: ControlConfig, legs: list[tuple[Posture, Posture, float]]) -> list[Motion]:
    return [move(config, start, end, speed) for start, end, speed in legs if _differs(start, end)]


def _differs(start: Posture, end: Posture) -> bool:
    apart = np.abs(end.tip_1 - start.tip_1).max() + np.abs(end.tip_2 - start.tip_2).max()
    return bool(apart > 1e-9 or start.angle != end.angle)
