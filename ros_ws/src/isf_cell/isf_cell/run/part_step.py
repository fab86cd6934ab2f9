"""One formed contour in the numbers an operator looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult


@dataclass(frozen=True)
class PartStep:
    """Contour ``index`` of ``count`` was formed.

    Attributes
    ----------
    depth : m, planned depth of the tool tip along its push; over a die, of the sheet pulled down with the blank holder
    forming_force : N, mean axial force on the forming tool
    support_force : N, mean normal force on the support tool in full control; NaN without force control
    correction : m, largest correction; NaN when unknown
    springback : m, largest predicted springback; NaN when none was predicted
    """

    index: int
    count: int
    depth: float
    forming_force: float
    support_force: float
    correction: float
    springback: float = float("nan")

    @staticmethod
    def of(nominal: Contour, correction: ContourCorrection | None, result: ContourResult) -> PartStep:
        """Numbers of one contour."""
        nan = float("nan")
        engaged = result.tick_engaged
        push = -1.0 if nominal.forming_tool == 1 else 1.0
        return PartStep(
            nominal.index,
            nominal.count,
            depth=float((push * (nominal.forming_tip[:, 2] + nominal.holder_height)).max()),
            forming_force=float(result.forming_force[:, 2].mean()) if len(result.forming_force) else nan,
            support_force=float(result.tick_normal_force[engaged].mean()) if engaged.any() else nan,
            correction=float(np.linalg.norm(correction.offset, axis=1).max(initial=0.0)) if correction else nan,
            springback=float(correction.springback.max()) if correction and len(correction.springback) else nan,
        )
