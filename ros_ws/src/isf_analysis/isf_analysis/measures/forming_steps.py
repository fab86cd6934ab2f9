"""The sheet after each of some steps of the forming, for people to look at: as scanned, or as swept by the tools.

Where the part was scanned between contours, a step is what was formed from one scan to the next. Without scans a step
is a contour, and the sheet is what the tools have swept so far: the envelope of the ball of the pressing tool along its
tips, which the sheet leaves along the planned wall, and what a closed contour encloses goes along with it. That knows
neither springback nor what forms beside the tools. Over a die, and in accumulative forming, which carries the part away
from the tools, it is the wanted shape as far as the contours have come.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, ContourResult, Process
from isf_core.errors import IsfError
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Mask
from scipy.ndimage import distance_transform_edt, gaussian_filter, uniform_filter

from isf_analysis.measures.contour_scan import ContourScan
from isf_analysis.measures.deviation import flange_level
from isf_analysis.measures.plan_mask import PlanShape
from isf_analysis.measures.record import PartRecord

MOST_STEPS = 60
MOST_NODES = 6_000
FINEST = 0.5e-3
"""m between nodes at least."""
POINTS_APART = 1.3
"""Mean distances of the points of a scan between nodes, at least."""
MARGIN = 12e-3
"""m of sheet around the path."""
FLATTEST, STEEPEST = math.radians(45.0), math.radians(85.0)
"""rad, of the swept wall: a flatter one would reach far into the flange from where corrected tips begin."""
FARTHEST = 4.0
"""Tool radii beyond which a swept wall ends."""
LEAST_SPREAD, LINED_UP = 0.35, 0.1
"""Cells, standard deviation of points along x and y, and 1 - r^2 of the two, below which points tell no slope: noise of
a scanner would tell any."""
EMPTY = 1e-6
"""Points in a cell, mean of nine, that are rounding of none."""
NEARLY_CLOSED = 0.1
"""Of a contour's length, between its ends: a turn of a spiral encloses what is inside it as a closed contour does."""

SCANNED, SWEPT, REACHED = "as scanned", "swept by the tools, not measured", "wanted shape so far, not measured"
"""What the sheet of a step is."""


@dataclass(frozen=True)
class FormingStep:
    """One step.

    Attributes
    ----------
    index : of the contour that ends it
    sheet : (ny, nx) m, upper face after it
    source : SCANNED, SWEPT or REACHED
    level : m, median height of the planned contacts of that contour; over a die how far the blank holder is down,
        negative
    upper, lower : (P, 3) m, tips of the tools along the contours of the step, measured where that is recorded, else as
        corrected; without points where a tool is away
    """

    index: int
    sheet: Array
    source: str
    level: float
    upper: Array
    lower: Array


@dataclass(frozen=True)
class FormingSteps:
    """Steps on the nodes ``x`` (nx,), ``y`` (ny,) m; ``before`` (ny, nx) m: the sheet before the first one; ``radii``
    m of upper and lower tool, 0 where not known; ``contours`` of the plan; ``over_die``: TPIF."""

    x: Array
    y: Array
    before: Array
    steps: tuple[FormingStep, ...]
    radii: tuple[float, float]
    contours: int
    over_die: bool


def forming_steps(record: PartRecord) -> FormingSteps | None:
    """Steps of ``record``, at most MOST_STEPS on at most MOST_NODES nodes.

    None: nothing was formed, or neither scans nor CAD tell the shape of a part over a die or of accumulative forming.
    """
    formed = _formed(record)
    if not formed:
        return None
    x, y = _grid([contour for contour, _ in formed], record)
    radii = _radii(record)
    scans = {scan.index: scan for scan in record.scans if scan.count}
    ends = [k for k, (contour, _) in enumerate(formed) if contour.index in scans]
    sheets: list[tuple[Array, str]] = []
    if ends:
        if record.scan is not None and ends[-1] != len(formed) - 1:
            ends.append(len(formed) - 1)
        ends = _some(ends)
        sheets = [(_scanned(scans.get(formed[k][0].index), record.scan, x, y), SCANNED) for k in ends]
    else:
        ends = _some(range(len(formed)))
        swept = _swept(formed, record, radii, x, y, ends)
        if swept is None:
            return None
        sheets = swept
    planned = {contour.index: contour for contour in record.nominal}
    steps = []
    for number, (end, (sheet, source)) in enumerate(zip(ends, sheets, strict=True)):
        begin = ends[number - 1] + 1 if number else 0
        contour = formed[end][0]
        tips = [_tips(*item)[:: 1 if item[0].forming_tool == 1 else -1] for item in formed[begin : end + 1]]
        upper, lower = (np.vstack([pair[k] for pair in tips]) for k in (0, 1))
        level = float(np.median(planned.get(contour.index, contour).contact[:, 2]))
        if contour.process is Process.TPIF:
            level = contour.holder_height
        steps.append(FormingStep(contour.index, sheet, source, level, upper, lower))
    if record.scan is not None and steps[-1].source != SCANNED:
        last, away = steps[-1], np.empty((0, 3))
        steps.append(FormingStep(last.index, _scanned(None, record.scan, x, y), SCANNED, last.level, away, away))
    return FormingSteps(x, y, np.zeros((len(y), len(x))), tuple(steps), radii, record.planned, record.process == "TPIF")


def _formed(record: PartRecord) -> list[tuple[Contour, ContourResult]]:
    """Corrected contours (nominal ones where that is not recorded) that were formed, with their results."""
    corrected = {contour.index: contour for contour in record.corrected}
    nominal = {contour.index: contour for contour in record.nominal}
    contours = {**nominal, **corrected}
    return [(contours[r.index], r) for r in record.results if r.completed and r.index in contours]


def _some(numbers: Sequence[int]) -> list[int]:
    """At most MOST_STEPS of ``numbers``, evenly, the last one among them."""
    count = min(len(numbers), MOST_STEPS)
    return [numbers[-1 - round(k * (len(numbers) - 1) / max(count - 1, 1))] for k in range(count)][::-1]


def _grid(contours: Sequence[Contour], record: PartRecord) -> tuple[Array, Array]:
    """(nx,), (ny,) m round the path, within what was scanned, no finer than its points."""
    path = np.vstack([contour.contact[:, :2] for contour in contours])
    low, high = path.min(axis=0) - MARGIN, path.max(axis=0) + MARGIN
    if record.scan is not None:
        low = np.maximum(low, [record.scan.x[0], record.scan.y[0]])
        high = np.minimum(high, [record.scan.x[-1], record.scan.y[-1]])
    finest = FINEST
    if known := [scan for scan in record.scans if scan.count]:
        plan = known[-1].points()[:, :2]
        finest = max(finest, POINTS_APART * float(np.sqrt(np.prod(np.ptp(plan, axis=0)) / len(plan))))
    spacing = max(finest, float(np.sqrt(np.prod(high - low) / MOST_NODES)))
    nx, ny = (max(2, int(length / spacing)) for length in high - low)
    return np.linspace(low[0], high[0], nx), np.linspace(low[1], high[1], ny)


def _radii(record: PartRecord) -> tuple[float, float]:
    """m, of upper and lower tool, 0 where there is none or the job cannot be read."""
    try:
        job = record.job()
    except IsfError:
        return 0.0, 0.0
    return job.tool_1.radius, job.tool_2.radius if job.tool_2 is not None else 0.0


def _tips(contour: Contour, result: ContourResult) -> tuple[Array, Array]:
    """(N, 3), (M, 3) m, where the tips of forming and support tool were: measured, else as corrected."""

    def told(measured: Array, planned: Array) -> Array:
        good = measured.shape == planned.shape and np.isfinite(measured).all()
        return measured if good else planned

    return told(result.forming_measured, contour.forming_tip), told(result.support_measured, contour.support_tip)


# -- sheet as scanned ---------------------------------------------------------------------------------


def _scanned(scan: ContourScan | None, final: HeightMap | None, x: Array, y: Array) -> Array:
    """(ny, nx) m, of ``scan``, or of the ``final`` one where there is none after this contour."""
    if scan is not None:
        return gridded(scan.points(), x, y)
    assert final is not None
    return _without_holes(final.at(_nodes(x, y)).reshape(len(y), len(x)))


def gridded(points: Array, x: Array, y: Array) -> Array:
    """(ny, nx) m, heights at the nodes ``x``, ``y`` m from ``points`` (P, 3) m in no order.

    A node takes the mean of the points of its cell, where there are none of the nine cells around, moved from their
    middle to the node along the slope of a plane through the points of the nine cells; one without any takes the height
    of the nearest one with some. All NaN without points on the grid.
    """
    column = np.rint((points[:, 0] - x[0]) / (x[1] - x[0])).astype(np.intp)
    row = np.rint((points[:, 1] - y[0]) / (y[1] - y[0])).astype(np.intp)
    inside = (column >= 0) & (column < len(x)) & (row >= 0) & (row < len(y)) & np.isfinite(points[:, 2])
    cell, seen = row[inside] * len(x) + column[inside], points[inside]

    def total(values: Array) -> Array:
        return np.bincount(cell, values, len(x) * len(y)).reshape(len(y), len(x))

    def around(values: Array) -> Array:
        return np.asarray(uniform_filter(values, 3, mode="constant"))

    count, sums = total(np.ones(len(seen))), [total(seen[:, k]) for k in range(3)]
    n, means = around(count), [around(one) for one in sums]

    def spread(j: int, k: int) -> Array:
        return around(total(seen[:, j] * seen[:, k])) - means[j] * means[k] / n

    with np.errstate(invalid="ignore", divide="ignore"):
        xx, yy, xy, xz, yz = spread(0, 0), spread(1, 1), spread(0, 1), spread(0, 2), spread(1, 2)
        square = xx * yy - xy**2
        wide = np.minimum(xx / n, yy / n) > (LEAST_SPREAD * (x[1] - x[0])) ** 2
        known = wide & (square > LINED_UP * xx * yy)
        dz_dx = np.where(known, (yy * xz - xy * yz) / square, 0.0)
        dz_dy = np.where(known, (xx * yz - xy * xz) / square, 0.0)
        across, along, z = (np.where(count > 0, one / count, mean / n) for one, mean in zip(sums, means, strict=True))
        z = z + dz_dx * (x - across) + dz_dy * (y[:, None] - along)
    return _without_holes(np.where(around(count) > EMPTY, z, np.nan))


def _without_holes(z: Array) -> Array:
    unknown = np.isnan(z)
    if not unknown.any() or unknown.all():
        return z
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.asarray(z[tuple(nearest)])


# -- sheet as swept -----------------------------------------------------------------------------------


def _swept(
    formed: Sequence[tuple[Contour, ContourResult]],
    record: PartRecord,
    radii: tuple[float, float],
    x: Array,
    y: Array,
    ends: Sequence[int],
) -> list[tuple[Array, str]] | None:
    """The sheet after the contours ``ends`` (numbers in ``formed``); None where it cannot be told."""
    process = formed[0][0].process
    if process in (Process.TPIF, Process.ADSIF):
        if record.target is None:
            return None
        wanted = _without_holes(record.target.at(_nodes(x, y)).reshape(len(y), len(x))) - flange_level(record.target)
        of = _over_die if process is Process.TPIF else _carried_down
        return [(of(formed[end][0], wanted, x, y), REACHED) for end in ends]
    blank = record.blank_thickness or 0.0
    sheet = np.zeros((len(y), len(x)))
    found = []
    for number, (contour, result) in enumerate(formed):
        tips, _ = _tips(contour, result)
        if contour.forming_tool == 1:
            _sweep(sheet, tips, contour, radii[0] or ball_of(contour), x, y)
        else:  # turned over: the lower face is the upper one
            turned = -sheet
            _sweep(turned, (tips + [0.0, 0.0, blank]) * [1.0, 1.0, -1.0], contour, radii[1] or ball_of(contour), x, y)
            sheet[...] = -turned
        if number in ends:
            found.append((sheet.copy(), SWEPT))
    return found


def ball_of(contour: Contour) -> float:
    """m, radius of the forming ball from its planned tips and contacts: tip = contact + R (n - e)."""
    way = contour.normal - np.array([0.0, 0.0, -contour.push_sign])
    square = (way**2).sum(axis=1)
    known = square > 1e-4
    if not known.any():
        return 0.0
    return float(np.median(((contour.forming_tip - contour.contact) * way).sum(axis=1)[known] / square[known]))


def _sweep(sheet: Array, tips: Array, contour: Contour, radius: float, x: Array, y: Array) -> None:
    """Push ``sheet`` (ny, nx) m down to a ball with its lowest point along ``tips`` (N, 3) m, and what it encloses.

    Where the ball is steeper than the wall (and than FLATTEST), the sheet leaves it along the wall.
    """
    if _encloses(contour):
        design = np.column_stack([np.ones(len(tips)), tips[:, :2]])
        plane = np.linalg.lstsq(design, tips[:, 2], rcond=None)[0]
        inside = _inside(tips, x, y)
        level = plane[0] + plane[1] * x + plane[2] * y[:, None]
        sheet[inside] = np.minimum(sheet, level)[inside]
    if radius <= 0.0:
        return
    way = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    step = 0.5 * (x[1] - x[0])
    chosen = np.unique(np.floor(np.concatenate([[0.0], np.cumsum(way)]) / step), return_index=True)[1]
    angle = np.clip(contour.wall_angle, FLATTEST, STEEPEST)
    for (px, py, pz), a in zip(tips[chosen].tolist(), angle[chosen].tolist(), strict=True):
        sine, slope = math.sin(a), math.tan(a)
        edge, rise = radius * sine, radius * (1.0 - math.cos(a))  # where the sheet leaves the ball
        reach = min(edge + max(-pz - rise, 0.0) / slope, FARTHEST * radius)
        i0, i1 = np.searchsorted(x, (px - reach, px + reach))
        j0, j1 = np.searchsorted(y, (py - reach, py + reach))
        square = (x[i0:i1] - px) ** 2 + (y[j0:j1, None] - py) ** 2
        ball = radius - np.sqrt(np.maximum(radius**2 - square, 0.0))
        wall = rise + (np.sqrt(square) - edge) * slope
        under = pz + np.where(square < edge**2, ball, wall)
        np.minimum(sheet[j0:j1, i0:i1], np.where(square < reach**2, under, np.inf), out=sheet[j0:j1, i0:i1])


def _encloses(contour: Contour) -> bool:
    """The contour goes round what it forms: its ends meet, and the forming tool is on the inner side of the wall."""
    tips = contour.forming_tip[:, :2]
    length = float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())
    if not contour.closed and np.linalg.norm(tips[0] - tips[-1]) > NEARLY_CLOSED * length:
        return False
    inwards = ((tips.mean(axis=0) - tips) * contour.normal[:, :2]).sum(axis=1)
    return bool(np.median(inwards) > 0.0)


def _inside(line: Array, x: Array, y: Array) -> Mask:
    """(ny, nx) nodes within the closed ``line`` (N, 2 or more) m in plan."""
    return PlanShape(line[:, :2]).holds(_nodes(x, y)).reshape(len(y), len(x))


def _nodes(x: Array, y: Array) -> Array:
    """(ny * nx, 2) m."""
    return np.column_stack([line.ravel() for line in np.meshgrid(x, y)])


def _over_die(contour: Contour, wanted: Array, x: Array, y: Array) -> Array:
    """The top of the ``wanted`` part (ny, nx) m that stands above the flange while the holder is where it is."""
    return np.maximum(wanted - float(np.nanmax(wanted)) - contour.holder_height, 0.0)


def _carried_down(contour: Contour, wanted: Array, x: Array, y: Array) -> Array:
    """The ``wanted`` part (ny, nx) m inside the contour, as far below as the tools are."""
    inside = _inside(contour.contact, x, y)
    at = HeightMap(x, y, wanted).at(contour.contact[:, :2])
    sheet = wanted + float(np.nanmedian(contour.contact[:, 2] - at))
    return np.asarray(gaussian_filter(np.where(inside, sheet, 0.0), 1.0))  # the edge lies between nodes
