"""Kinematics: from the pose of a tool to the positions of the axes that make it, and back.

A tool's pose is its tip (3,) m in frame ``sheet`` and the tilt of its axis, (2,) rad about x, then about y. A machine
names its kinematics in the rig file. Two are here: the gantry, whose axes are the coordinates of the tip, and the
hexapod of the SPIF-A machine (Torrao 2013, chapter 4) with six cylinders between a base and a moving platform.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

UPRIGHT = np.zeros(2)
"""Tilt of a tool whose axis is z."""


class Kinematics(Protocol):
    """One tool's kinematics.

    Attributes
    ----------
    axes : names of the axes
    """

    @property
    def axes(self) -> tuple[str, ...]: ...

    def positions(self, tip: Array, tilt: Array = UPRIGHT) -> Array:
        """(A,) m, axis positions for the tip (3,) m and tilt (2,) rad; raises TARGET_OUT_OF_WORKSPACE."""
        ...

    def tip(self, positions: Array) -> tuple[Array, Array]:
        """Tip (3,) m and tilt (2,) rad of the axis positions (A,) m; raises TARGET_OUT_OF_WORKSPACE."""
        ...


@dataclass(frozen=True)
class Gantry:
    """Three linear axes along x, y and z; the tool does not tilt.

    Attributes
    ----------
    axes : three names, ("X", "Y", "Z") for an upper tool, ("U", "V", "W") for a lower one
    """

    axes: tuple[str, ...] = ("X", "Y", "Z")

    def positions(self, tip: Array, tilt: Array = UPRIGHT) -> Array:
        """(3,) m, the tip itself."""
        if np.any(np.asarray(tilt) != 0.0):
            raise IsfError(ErrorCode.TARGET_OUT_OF_WORKSPACE, "a gantry cannot tilt its tool", where="kinematics")
        return np.array(tip, dtype=np.float64)

    def tip(self, positions: Array) -> tuple[Array, Array]:
        """The positions themselves, upright."""
        return np.array(positions, dtype=np.float64), UPRIGHT.copy()


def _semi_regular_hexagon(long_edge: float, short_edge: float, *, short_first: bool) -> Array:
    """(6, 2) m, corners of a hexagon with alternating edges, in the order of the legs (Torrao 2013, 4.2)."""
    slope = np.tan(np.pi / 6)
    outer = (long_edge / 2 + short_edge) * slope
    middle = (short_edge / 2 + long_edge) * slope
    inner = (long_edge - short_edge) / 2 * slope
    if short_first:  # the short edge stands at -x
        corners = [(-middle, -short_edge / 2), (inner, (long_edge + short_edge) / 2), (outer, long_edge / 2)]
    else:  # the long edge stands at -x
        corners = [(-outer, -long_edge / 2), (-inner, (long_edge + short_edge) / 2), (middle, short_edge / 2)]
    first, third, fourth = corners
    mirror = np.array([1.0, -1.0])
    return np.array(
        [first, mirror * np.array(first), third, fourth, mirror * np.array(fourth), mirror * np.array(third)]
    )


@dataclass(frozen=True)
class Hexapod:
    """Six cylinders between a fixed base (above) and a platform that carries an upper tool pointing down.

    Attributes
    ----------
    base, platform : (6, 2) m, joints in their plates' planes (published: edges 600/200 and 300/150 mm)
    shortest, stroke : m, cylinder between joints when retracted, and its stroke (published: 942, 400 mm)
    tool_length : m, platform plane to tip (published: 338 mm + tool; the tool of 100 mm)
    sheet : (3,) m, origin of frame ``sheet`` in the base's frame (assumed: the table's height is a set-up value)
    tilt_limit : rad (published: 30 deg about x and y) ; reach : m, of the platform in x and y (published: 500 mm)
    """

    base: Array
    platform: Array
    shortest: float = 0.942
    stroke: float = 0.400
    tool_length: float = 0.438
    sheet: tuple[float, float, float] = (0.0, 0.0, -1.555)
    tilt_limit: float = float(np.radians(30.0))
    reach: float = 0.5

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the cylinders."""
        return tuple(f"L{k}" for k in range(1, 7))

    def lengths(self, place: Array, tilt: Array) -> Array:
        """(6,) m, distances between joints for the platform's origin (3,) m in the base's frame."""
        joints = np.column_stack([self.platform, np.zeros(6)]) @ _rotation(tilt).T + place
        return np.asarray(np.linalg.norm(joints - np.column_stack([self.base, np.zeros(6)]), axis=1))

    def positions(self, tip: Array, tilt: Array = UPRIGHT) -> Array:
        """(6,) m, strokes of the cylinders (0 retracted); orientation turns about the tip."""
        tilt = np.asarray(tilt, dtype=np.float64)
        place = np.asarray(tip) + np.array(self.sheet) + _rotation(tilt) @ np.array([0.0, 0.0, self.tool_length])
        strokes = self.lengths(place, tilt) - self.shortest
        if np.abs(place[:2]).max() > self.reach or np.abs(tilt).max() > self.tilt_limit:
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE, "the platform would leave its reach or tilt", where="kinematics"
            )
        if strokes.min() < 0.0 or strokes.max() > self.stroke:
            worst = int(np.argmax(np.maximum(-strokes, strokes - self.stroke)))
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE,
                f"cylinder {worst + 1} would have a stroke of {1e3 * strokes[worst]:.1f} mm, "
                f"0 to {1e3 * self.stroke:.0f} mm is available",
                where="kinematics",
                advice="move the part or the table",
            )
        return strokes

    def tip(self, positions: Array) -> tuple[Array, Array]:
        """Tip (3,) m and tilt (2,) rad by Newton's method over the five freedoms of a tool without spin."""
        lengths = np.asarray(positions) + self.shortest
        pose = np.array([0.0, 0.0, -np.sqrt(max(float(lengths.mean()) ** 2 - _OFFSET_SQUARE, 1e-6)), 0.0, 0.0])
        for _ in range(30):
            residual = lengths - self.lengths(pose[:3], pose[3:])
            if np.abs(residual).max() < 1e-12:
                break
            slopes = np.column_stack([self._slope(pose, k) for k in range(5)])
            pose += np.linalg.lstsq(slopes, residual, rcond=None)[0]
        if not np.abs(lengths - self.lengths(pose[:3], pose[3:])).max() < 1e-6:
            raise IsfError(
                ErrorCode.TARGET_OUT_OF_WORKSPACE, "no pose without spin has these cylinder lengths", where="kinematics"
            )
        arm = _rotation(pose[3:]) @ np.array([0.0, 0.0, self.tool_length])
        return pose[:3] - arm - np.array(self.sheet), pose[3:]

    def _slope(self, pose: Array, k: int) -> Array:
        step = np.zeros(5)
        step[k] = 1e-6
        ahead, behind = pose + step, pose - step
        return (self.lengths(ahead[:3], ahead[3:]) - self.lengths(behind[:3], behind[3:])) / 2e-6


_OFFSET_SQUARE = 0.236291**2
"""m^2, squared horizontal offset of every leg at the centre."""


def _rotation(tilt: Array) -> Array:
    """(3, 3) Ry(tilt[1]) Rx(tilt[0])."""
    cx, sx, cy, sy = np.cos(tilt[0]), np.sin(tilt[0]), np.cos(tilt[1]), np.sin(tilt[1])
    return np.array([[cy, sy * sx, sy * cx], [0.0, cx, -sx], [-sy, cy * sx, cy * cx]])


def spif_a() -> Hexapod:
    """The hexapod of the SPIF-A machine."""
    return Hexapod(
        base=_semi_regular_hexagon(0.6, 0.2, short_first=True),
        platform=_semi_regular_hexagon(0.3, 0.15, short_first=False),
    )


def make_kinematics(name: str) -> tuple[Kinematics, Kinematics]:
    """Kinematics of the upper and the lower tool by the name in the rig file."""
    lower = Gantry(("U", "V", "W"))
    return (spif_a(), lower) if name == "hexapod_spif_a" else (Gantry(), lower)
