"""Limits that protect the machine: what is wrong with a target or with a force, as codes and texts."""

from __future__ import annotations

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.kinematics import Kinematics
from numpy.typing import NDArray

from isf_sim import machine_tick as mt

Array = NDArray[np.float64]
Finding = tuple[ErrorCode, str]

LIMIT_TRAVEL, LIMIT_SPEED, LIMIT_FORCE = 1, 2, 4
"""Flags of limits that were hit, as in isf_msgs/msg/MachineState."""


def target_faults(bits: int, target: Array, held: Array, allowed: float, travel: Array) -> tuple[int, list[Finding]]:
    """Limit flags and faults for the ``bits`` of machine_tick.check_target.

    ``target``, ``held`` (6,) m ; ``allowed`` m in one tick ; ``travel`` (3,) m
    """
    flags, faults = 0, []
    if bits & mt.FAST:
        flags |= LIMIT_SPEED
    if bits & mt.NOT_FINITE:
        faults.append((ErrorCode.TARGET_NOT_FINITE, f"target {millimetres(target)} is not a position"))
    if bits & mt.JUMP:
        flags |= LIMIT_SPEED
        steps = np.linalg.norm((target - held).reshape(2, 3), axis=1)
        faults.append(
            (
                ErrorCode.TARGET_JUMP,
                f"target of tool {1 + int(np.argmax(steps))} jumps by {1e3 * steps.max():.3f} mm in one tick, "
                f"{1e3 * allowed:.3f} mm allowed",
            )
        )
    if bits & mt.OUTSIDE:
        flags |= LIMIT_TRAVEL
        faults.append(
            (
                ErrorCode.TARGET_OUT_OF_WORKSPACE,
                f"target {millimetres(target)} is outside the travel of +-{millimetres(travel)}",
            )
        )
    if bits & mt.OVERLAP:
        faults.append((ErrorCode.TOOL_COLLISION, f"the tools would run into each other at {millimetres(target)}"))
    return flags, faults


def reach_fault(kinematics: tuple[Kinematics, Kinematics], target: Array) -> Finding | None:
    """TARGET_OUT_OF_WORKSPACE when an axis cannot make the tip of ``target`` (6,) m, else None."""
    try:
        kinematics[0].positions(target[:3])
        kinematics[1].positions(target[3:])
    except IsfError as error:
        return error.code, f"target {millimetres(target)}: {error.what}"
    return None


def force_faults(flags: int, force_1: Array, force_2: Array, limit: Array) -> tuple[int, list[Finding]]:
    """Limit flags and faults for the flags of a tick; forces and limit (3,) N."""
    limits, faults = 0, []
    if flags & mt.FORCE_EXCEEDED:
        limits |= LIMIT_FORCE
        faults.append(
            (
                ErrorCode.FORCE_LIMIT,
                f"force on tool 1 {np.round(force_1)} N, on tool 2 {np.round(force_2)} N; limit {limit} N per axis",
            )
        )
    if flags & mt.TOOLS_TOUCH:
        faults.append((ErrorCode.TOOL_COLLISION, "the tools press through the sheet"))
    return limits, faults


def millimetres(position: Array) -> str:
    """Text "(x, y, z) mm" of a position in m."""
    return "(" + ", ".join(f"{1e3 * value:.3f}" for value in position) + ") mm"
