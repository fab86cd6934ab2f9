"""Kinematics: from the pose of a tool to the positions of the axes that make it, and back.

A tool's pose is a point (3,) m of it in frame ``sheet`` and the tilt of its axis, (2,) rad about x, then about y. The
point is where the axis leaves the tip, which of an upright tool is its tip, and of a tilted one
:func:`isf_core.geometry.tool_axis.point_on_axis`. A machine names its kinematics in the rig file: the gantry, whose
axes are the coordinates of the tip, the hexapod of :mod:`isf_core.geometry.hexapod`, or six-axis arms
(:mod:`isf_core.geometry.serial_arm`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.hexapod import Hexapod
from isf_core.geometry.serial_arm import SerialArm
from isf_core.types import Array, Mask

UPRIGHT = np.zeros(2)
"""Tilt of a tool whose axis is z."""


class Kinematics(Protocol):
    """One tool's kinematics.

    Attributes
    ----------
    axes : names of the axes
    tilt_limit : rad, largest tilt of the tool, 0 where it is always upright
    tilt_lever : m, from its tip to what the machine tilts it with, at most
    """

    @property
    def axes(self) -> tuple[str, ...]: ...

    @property
    def tilt_limit(self) -> float: ...

    @property
    def tilt_lever(self) -> float: ...

    def positions(self, tip: Array, tilt: Array = UPRIGHT) -> Array:
        """(A,) m or rad, axis positions for the tip (3,) m and tilt (2,) rad; raises TARGET_OUT_OF_WORKSPACE."""
        ...

    def tip(self, positions: Array) -> tuple[Array, Array]:
        """Tip (3,) m and tilt (2,) rad of the axis positions (A,) m or rad; raises TARGET_OUT_OF_WORKSPACE."""
        ...

    def reachable(self, tips: Array, tilts: Array = UPRIGHT) -> Mask:
        """(N,), the axes can make the tips (N, 3) m with the tilts (N, 2) or (2,) rad."""
        ...


@dataclass(frozen=True)
class Gantry:
    """Three linear axes along x, y and z; the tool does not tilt.

    Attributes
    ----------
    axes : three names, ("X", "Y", "Z") for an upper tool, ("U", "V", "W") for a lower one
    tilt_limit, tilt_lever : rad and m, none
    """

    axes: tuple[str, ...] = ("X", "Y", "Z")
    tilt_limit: float = 0.0
    tilt_lever: float = 0.0

    def positions(self, tip: Array, tilt: Array = UPRIGHT) -> Array:
        """(3,) m, the tip itself."""
        if np.any(np.asarray(tilt) != 0.0):
            raise IsfError(ErrorCode.TARGET_OUT_OF_WORKSPACE, "a gantry cannot tilt its tool", where="kinematics")
        return np.array(tip, dtype=np.float64)

    def tip(self, positions: Array) -> tuple[Array, Array]:
        """The positions themselves, upright."""
        return np.array(positions, dtype=np.float64), UPRIGHT.copy()

    def reachable(self, tips: Array, tilts: Array = UPRIGHT) -> Mask:
        """(N,), every tip of an upright tool: the travel is a limit of the rig, not of the axes."""
        upright = ~np.asarray(tilts != 0.0).any(axis=-1)
        return np.broadcast_to(upright, np.shape(tips)[:-1]).copy()


def make_kinematics(
    upper: Hexapod | SerialArm | None = None, lower: SerialArm | None = None
) -> tuple[Kinematics, Kinematics]:
    """Kinematics of the upper and the lower tool: gantries, where nothing else carries them."""
    return upper or Gantry(), lower or Gantry(("U", "V", "W"))
