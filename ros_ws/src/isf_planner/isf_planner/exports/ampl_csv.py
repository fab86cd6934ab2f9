"""CSV files as AMPL Toolpaths writes and reads them: contacts with surface properties (17 columns), tool tips.

Columns of the contacts: contact x, y, z; normal x, y, z; maximum curvature and its direction; minimum curvature and
its direction; mean and Gaussian curvature; end of revolution (1 at the last point of a contour). Lengths in mm,
curvatures in 1/mm, positive where the surface bends towards the tool. Tip files hold x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job
from isf_core.process import thickness_and_tips
from isf_core.types import Array
from scipy.spatial import KDTree

from isf_planner.planning import Plan

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


def read_contacts(path: Path) -> list[tuple[Array, Array]]:
    """Contacts (n, 3) m and unit normals (n, 3) of every contour of a file of contacts with 17 columns.

    Raises
    ------
    IsfError : FILE_NOT_FOUND; EXPORT_UNREADABLE with the line at fault
    """
    table = _load(path, 17)
    normal = table[:, 3:6]
    length = np.linalg.norm(normal, axis=1)
    bad = np.abs(length - 1.0) > 0.01
    if bad.any():
        line = int(np.argmax(bad)) + 2
        raise _unreadable(path, f"normal of length {length[line - 2]:.3f}", line)
    ends = np.flatnonzero(table[:, 16] != 0)
    cuts = np.unique(np.append(ends[:-1] + 1 if len(ends) and ends[-1] == len(table) - 1 else ends + 1, len(table)))
    contact, unit = table[:, :3] / MM, normal / length[:, None]
    return [(contact[a:b], unit[a:b]) for a, b in zip(np.append(0, cuts[:-1]), cuts, strict=True) if b - a >= 3]


def read_tips(path: Path) -> Array:
    """(N, 3) m, tips of a file with three columns; IsfError as :func:`read_contacts`."""
    return _load(path, 3) / MM


def contours_from_contacts(loops: Sequence[tuple[Array, Array]], job: Job, plan_id: str) -> tuple[Contour, ...]:
    """Contours of ``loops`` (contacts, normals) for the tools, sheet and feed of ``job``: sine law, DSIF or SPIF."""
    contours = []
    for index, (contact, normal) in enumerate(loops):
        angle = np.arccos(np.clip(np.abs(normal[:, 2]), 0.0, 1.0))
        formed = thickness_and_tips.sine_law(job.sheet.thickness, angle)
        support = np.empty((0, 3))
        if job.tool_2 is not None and job.process == "DSIF":
            support = thickness_and_tips.support_tip(
                contact, normal, job.tool_2.radius, job.path.squeeze_factor * formed
            )
        contours.append(
            Contour(
                plan_id=plan_id,
                index=index,
                count=len(loops),
                process=job.process_type,
                feed=job.path.feed,
                contact=contact,
                normal=normal,
                wall_angle=angle,
                thickness=formed,
                forming_tip=thickness_and_tips.forming_tip(contact, normal, job.tool_1.radius),
                support_tip=support,
            ).validate()
        )
    return tuple(contours)


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


def _load(path: Path, columns: int) -> Array:
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "cannot be read", where=str(path)) from error
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        try:
            row = [float(value) for value in line.split(",")]
        except ValueError as error:
            raise _unreadable(path, "not a row of numbers", number) from error
        if len(row) != columns or not np.isfinite(row).all():
            raise _unreadable(path, f"{len(row)} values, {columns} finite ones are needed", number)
        rows.append(row)
    if not rows:
        raise _unreadable(path, "holds no points", 1)
    return np.array(rows)


def _unreadable(path: Path, what: str, line: int) -> IsfError:
    advice = "contacts need the 17 columns of AMPL Toolpaths with one header line"
    return IsfError(ErrorCode.EXPORT_UNREADABLE, what, where=f"{path}:{line}", advice=advice)
