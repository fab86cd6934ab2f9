"""Positions of the joints of a cell from the poses of the tool tips that its driver tells."""

from __future__ import annotations

import math
from collections.abc import Callable

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import Rig
from isf_core.geometry.hexapod import spif_a

from isf_description.hexapod import leg_positions
from isf_description.tree import Quaternion, Vector

ROLL = math.radians(0.5)
"""rad; turn about z beyond which a pose is none of a machine that cannot turn its tool so."""

Positions = dict[str, float]


def tool_positions(rig: Rig, number: int) -> Callable[[Vector, Quaternion], Positions]:
    """Function from tip (m, frame ``sheet``) and orientation of tool ``number`` to positions (m, rad) by joint.

    A gantry does not turn its tools: their orientation is not looked at. The function raises IsfError
    TARGET_OUT_OF_WORKSPACE for what is no pose of the machine.
    """
    if number == 1 and rig.kinematics == "hexapod_spif_a":
        return _hexapod()
    names = [f"tool_{number}_{axis}" for axis in "xyz"]

    def gantry(tip: Vector, _: Quaternion) -> Positions:
        _check(tip)
        return dict(zip(names, tip, strict=True))

    return gantry


def _hexapod() -> Callable[[Vector, Quaternion], Positions]:
    machine = spif_a()

    def positions(tip: Vector, turn: Quaternion) -> Positions:
        _check(tip)
        tilt = tilt_of(turn)
        own = dict(
            zip(("tool_1_x", "tool_1_y", "tool_1_z", "tool_1_tilt_x", "tool_1_tilt_y"), (*tip, *tilt), strict=True)
        )
        return own | leg_positions(machine, tip, tilt)

    return positions


def tilt_of(turn: Quaternion) -> tuple[float, float]:
    """rad about x and y of a turn Ry Rx; raises IsfError TARGET_OUT_OF_WORKSPACE when it is none."""
    x, y, z, w = turn
    if not abs(math.hypot(x, y, z, w) - 1.0) < 1e-3:
        raise IsfError(ErrorCode.TARGET_OUT_OF_WORKSPACE, "the orientation is no quaternion of length 1", where="pose")
    roll = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    if abs(roll) > ROLL:
        raise IsfError(
            ErrorCode.TARGET_OUT_OF_WORKSPACE,
            f"the tool is turned by {math.degrees(roll):.1f} deg about z, which the hexapod cannot do",
            where="pose",
            advice="publish the tilt of the tool's axis alone",
        )
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)), pitch


def _check(tip: Vector) -> None:
    if not all(math.isfinite(value) for value in tip):
        raise IsfError(ErrorCode.TARGET_NOT_FINITE, "the tip has a coordinate that is no number", where="pose")
