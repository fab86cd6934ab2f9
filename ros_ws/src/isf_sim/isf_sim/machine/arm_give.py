"""How far the arms of a machine give way under the forces on their tools.

The compliance of an arm is that of its joints where it stands (J K^-1 J^T), times the variant's factor. Its own part in
x, y and z, at the middle of the sheet, is added to that of the tool, where the sheet's equilibrium takes it in at once;
the rest - force in one direction that moves the tip in another one, and what changes over the sheet - follows the force
of the tick before as the first mode of the arm lets it. Encoders see none of it. m, N, frame ``sheet``.
"""

from __future__ import annotations

import copy
import math

import numpy as np
from isf_core.files.job import JobFile
from isf_core.files.rig import Rig, ToolAxis
from isf_core.geometry.serial_arm import SerialArm
from isf_core.types import Array

AGAIN = 2.0e-3
"""m, way of a tip after which the compliance is found anew: it changes by less than a thousandth."""


def with_arms(plant_file: JobFile) -> JobFile:
    """``plant_file`` with tools that give way by themselves as the arms do at the middle of the sheet."""
    rig = plant_file.rig
    if rig.arm(1) is None and rig.arm(2) is None:
        return plant_file
    made = copy.copy(plant_file)
    tools = {f"tool_{k}": _softer(tool, rig.arm(k)) for k, tool in ((1, rig.tool_1), (2, rig.tool_2))}
    made.rig = rig.model_copy(update=tools)
    return made


def _softer(tool: ToolAxis, arm: SerialArm | None) -> ToolAxis:
    if arm is None:
        return tool
    return tool.model_copy(update={"compliance": tuple(np.add(tool.compliance, _own(arm)).tolist())})


def _own(arm: SerialArm) -> Array:
    """(3,) m/N, in x, y and z at the middle of the sheet."""
    return np.diagonal(arm.compliance(arm.held(np.zeros(3))[0])).copy()


class ArmGive:
    """What is left to the arms of ``rig``; ``factor`` of the variant, ``rate`` of control Hz.

    Attributes
    ----------
    at : (2, 5) m and rad, tips and tilts at which the compliance was found, NaN before it was ; rest : (2, 3, 3) m/N,
        that compliance without what the tools have of it
    """

    def __init__(self, rig: Rig, factor: float, rate: float) -> None:
        self._arms = (rig.arm(1), rig.arm(2))
        specs = (rig.tool_1.arm, rig.tool_2.arm)
        self._share = [
            0.0 if spec is None else 1.0 - math.exp(-2.0 * math.pi * spec.natural_frequency / rate) for spec in specs
        ]
        self._own = [np.zeros((3, 3)) if arm is None else np.diag(_own(arm)) for arm in self._arms]
        self._factor = factor
        self.at = np.full((2, 5), np.nan)
        self.rest = np.zeros((2, 3, 3))

    @property
    def present(self) -> bool:
        """An arm carries a tool."""
        return any(arm is not None for arm in self._arms)

    def move(self, tips: Array, forces: tuple[Array, Array], tilt: Array, way: Array) -> None:
        """Add to the ``tips`` (2, 3) m by how far the arms have given way, one tick on.

        ``forces`` (3,) N on the tools in the last tick; ``tilt`` (2,) rad of tool 1; ``way`` (2, 3) m is kept here.
        """
        for k, arm in enumerate(self._arms):
            if arm is None:
                continue
            place = np.append(tips[k], tilt if k == 0 else (0.0, 0.0))
            if not np.abs(place - self.at[k]).max() <= AGAIN:
                joints, margin, _ = arm.held(tips[k], place[3:])
                if np.isfinite(margin):
                    self.rest[k], self.at[k] = self._factor * (arm.compliance(joints) - self._own[k]), place
            way[k] += self._share[k] * (self.rest[k] @ forces[k] - way[k])
            tips[k] += way[k]
