"""The entry on to a contour from the air: on a ramp from the level of the contour before.

A tool that is set down with the whole step of its contour below it leaves a dent where it stands. On the simulated
cone of Ren 2018, with tools that leave the sheet for every scan, the places where contours begin came out 0.71 mm too
deep when set down so, 0.53 mm on a ramp. With tools that never leave, the largest error of that part is 0.50 mm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from isf_force_ctrl.trajectory import ToolPath

LENGTH = 3e-3
"""m of path on which the step is reached. Up to 10 mm it gave the same on that cone, 20 mm less (0.63 mm); what the
ramp itself leaves over a backing plate is 0.29 mm high with 5 mm, 0.25 mm with 3 mm (lu_pyramid, everywhere else less
than that)."""
STEEPEST = 0.75
"""Largest step over :data:`LENGTH`: further down the contour before is not what this one goes on from."""
NEAR = 5e-3
"""m in plan within which the contour before is the level that is entered from."""


def ramped(path: ToolPath, before: ToolPath | None) -> ToolPath:
    """``path`` of M vertices, its begin raised to the level of ``before``, the contour formed last, at that place.

    Under force control the supporting tool is raised as well, so that the gap stays what it is along the contour.
    Unchanged where ``before`` was formed by the other tool, lies further away, no higher, or far above.
    """
    if before is None or before.forming != path.forming:
        return path
    begin = path.forming_tip[0]
    apart = np.linalg.norm(before.forming_tip[:, :2] - begin[:2], axis=1)
    nearest = int(np.argmin(apart))
    up = 1.0 if path.forming == 1 else -1.0
    step = up * float(before.forming_tip[nearest, 2] - begin[2])
    if apart[nearest] > NEAR or not 0.0 < step <= STEEPEST * LENGTH:
        return path
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.forming_tip, axis=0), axis=1))])
    raised = np.zeros_like(path.forming_tip)
    raised[:, 2] = up * step * np.clip(1.0 - way / LENGTH, 0.0, 1.0)
    forced = bool(np.isfinite(path.set_point[0]))
    return replace(
        path,
        tip_1=path.tip_1 + raised if forced or path.forming == 1 else path.tip_1,
        tip_2=path.tip_2 + raised if forced or path.forming == 2 else path.tip_2,
    )
