"""The joints that move a tool, by their names in the cell's description: positions for a pose of the tool, and back.

What a joint is depends on the machine: the coordinates of the tip on a gantry, six angles of an arm, the strokes of a
hexapod's six cylinders. Poses are the tip (3,) m in frame ``sheet`` and the axis (3,) of
:mod:`isf_core.geometry.tool_axis`, that of an upright tool for a lower one, which is always upright.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import Rig
from isf_core.geometry.hexapod import Hexapod
from isf_core.geometry.kinematics import Kinematics
from isf_core.geometry.serial_arm import SerialArm
from isf_core.geometry.tool_axis import UPRIGHT, axis_of, point_on_axis, tilt_of, tip_of_point
from isf_core.types import Array
from isf_core.warm_up import warm_up

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ToolJoints:
    """Joints of one tool.

    Attributes
    ----------
    names : in the description of the cell, such as tool_1_x, tool_2_A1, leg_1_stroke
    kinematics : of the tool
    ball : m, radius of its tip, about which it is tilted
    """

    names: tuple[str, ...]
    kinematics: Kinematics
    ball: float

    @staticmethod
    def of(rig: Rig, tool: int, ball: float) -> ToolJoints:
        """Joints of ``tool`` (1, 2) of ``rig``, whose tip has a ``ball`` of that radius in m."""
        kinematics = rig.make_kinematics()[tool - 1]
        if isinstance(kinematics, Hexapod):
            warm_up()  # its kernels are loaded now, not in the first tick
            names = tuple(f"leg_{k}_stroke" for k in range(1, 7))
        elif isinstance(kinematics, SerialArm):
            names = tuple(f"tool_{tool}_{name}" for name in kinematics.axes)
        else:
            names = tuple(f"tool_{tool}_{axis}" for axis in "xyz")
        return ToolJoints(names, kinematics, ball)

    def positions(self, tip: Sequence[float] | Array, axis: Sequence[float] = UPRIGHT) -> Array:
        """(J,) m or rad for ``tip`` (3,) m and ``axis`` (3,). Limits of joints are looked at by who moves them.

        Raises IsfError TARGET_OUT_OF_WORKSPACE where no joints make that.
        """
        point, tilt = np.array(tip, dtype=np.float64), np.zeros(2)
        if tuple(axis) != UPRIGHT:
            leaning = np.array(axis, dtype=np.float64)
            point, tilt = point_on_axis(point, leaning, self.ball), tilt_of(leaning)
        if isinstance(self.kinematics, SerialArm):
            joints, margin, _ = self.kinematics.held(point, tilt)
            if not np.isfinite(margin):
                what = f"{self.kinematics.name} is too short for the tip"
                raise IsfError(ErrorCode.TARGET_OUT_OF_WORKSPACE, what, where="kinematics")
            return joints
        return self.kinematics.positions(point, tilt)

    def pose(self, positions: Sequence[float]) -> tuple[Vector, Vector]:
        """Tip (3,) m and axis (3,) of the joints at ``positions`` (J,) m or rad.

        Raises IsfError TARGET_OUT_OF_WORKSPACE where the joints cannot be there together.
        """
        point, tilt = self.kinematics.tip(np.array(positions, dtype=np.float64))
        if self.kinematics.tilt_limit == 0.0:
            x, y, z = point.tolist()
            return (x, y, z), UPRIGHT
        axis = axis_of(tilt)
        x, y, z = tip_of_point(point, axis, self.ball).tolist()
        a, b, c = axis.tolist()
        return (x, y, z), (a, b, c)
