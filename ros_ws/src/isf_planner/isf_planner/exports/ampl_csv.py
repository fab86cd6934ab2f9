"""CSV files as AMPL Toolpaths writes them: contacts with surface properties (17 columns), tool tips.

Columns of the contacts: contact x, y, z; normal x, y, z; maximum curvature and its direction; minimum curvature and
its direction; mean and Gaussian curvature; end of revolution (1 at the last point of a contour). Lengths in mm,
curvatures in 1/mm, positive where the surface bends towards the tool. Tip files hold x, y, z.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array
from scipy.spatial import KDTree

from isf_planner.part_plan import Plan

COLUMNS = (
    "contactPntX,contactPntY,contactPntZ,normalX,normalY,normalZ,"
    "maxCurvature,maxCurvDirectionX,maxCurvDirectionY,maxCurvDirectionZ,"
    "minCurvature,minCurvDirectionX,minCurvDirectionY,minCurvDirectionZ,"
    "meanCurvature,GaussianCurvature,endOfRevolution(T/F)"
)

UNASSIGNED = -999999.999
"""What AMPL Toolpaths writes for a property that is not known."""

MM = 1e3
SIDES = {1: "top", 2: "bot"}


def write_csv(plan: Plan, path: Path) -> list[Path]:
    """Write contacts and tips of a plan beside ``path`` and return the files; IsfError FILE_NOT_WRITABLE.

    NAME_topContactPnts.csv (or bot, of a lower forming tool), NAME_topToolTipPnts.csv, NAME_botToolTipPnts.csv.
    """
    stem = path.stem
    side = SIDES[plan.contours[0].forming_tool]
    table = np.vstack([_rows(contour, plan) for contour in plan.contours])
    written = [_save(path.with_name(f"{stem}_{side}ContactPnts.csv"), table, COLUMNS, [*["%.6f"] * 16, "%d"])]
    for tool in (1, 2):
        tips = [_tip(contour, tool) for contour in plan.contours]
        if all(len(tip) for tip in tips):
            target = path.with_name(f"{stem}_{SIDES[tool]}ToolTipPnts.csv")
            written.append(_save(target, np.vstack(tips) * MM, "X,Y,Z", ["%.6f"] * 3))
    return written


def _rows(contour: Contour, plan: Plan) -> Array:
    """(n, 17) in the units of the file."""
    n = len(contour)
    around = np.roll(contour.contact, -1, axis=0) - np.roll(contour.contact, 1, axis=0)
    if not contour.closed:
        around[0], around[-1] = around[1], around[-2]
    around -= (around * contour.normal).sum(axis=1, keepdims=True) * contour.normal
    around /= np.maximum(np.linalg.norm(around, axis=1, keepdims=True), 1e-12)
    down = np.cross(contour.normal, around)
    larger, smaller = _curvatures(contour, plan)
    properties = np.full((n, 10), UNASSIGNED)
    if len(larger):
        # principal directions of a wall formed in contours: along the contour and across it; the curvature along is
        # the turn of the normal per length of path
        turn = np.roll(contour.normal, -1, axis=0) - np.roll(contour.normal, 1, axis=0)
        way = np.linalg.norm(np.roll(contour.contact, -1, axis=0) - np.roll(contour.contact, 1, axis=0), axis=1)
        along = -(turn * around).sum(axis=1) / np.maximum(way, 1e-12)
        along_is_larger = (np.abs(along - larger) <= np.abs(along - smaller))[:, None]
        first, second = np.where(along_is_larger, around, down), np.where(along_is_larger, down, around)
        mean, gauss = (larger + smaller) / 2 / MM, larger * smaller / MM**2
        properties = np.column_stack([larger / MM, first, smaller / MM, second, mean, gauss])
    end = np.zeros(n)
    end[-1] = 1
    return np.column_stack([contour.contact * MM, contour.normal, properties, end])


def _curvatures(contour: Contour, plan: Plan) -> tuple[Array, Array]:
    """Principal curvatures (n,) 1/m of the nearest contacts of the plan's loops, or (0,) when it has none."""
    if plan.tree is None or not all(len(loop.curvature) for loop in plan.tree.loops):
        return np.empty(0), np.empty(0)
    tips = np.vstack([loop.tip for loop in plan.tree.loops])
    curvature = np.vstack([loop.curvature for loop in plan.tree.loops])
    nearest = KDTree(tips).query(contour.forming_tip)[1]
    return curvature[nearest, 0], curvature[nearest, 1]


def _tip(contour: Contour, tool: int) -> Array:
    return contour.forming_tip if tool == contour.forming_tool else contour.support_tip


def _save(path: Path, table: Array, header: str, form: list[str]) -> Path:
    try:
        np.savetxt(path, table, fmt=form, delimiter=",", header=header, comments="")
    except OSError as error:
        what = f"the table cannot be written: {error.strerror}"
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, what, where=str(path)) from error
    return path
