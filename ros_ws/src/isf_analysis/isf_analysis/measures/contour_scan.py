"""Scans made between contours, as the control of the shape saw them: kept small, and what they say of the part so far.

A scan of a quarter of a square metre has tens of thousands of points. Kept are whole hundredths of a millimetre in plan
and whole micrometres of height (a scanner is good for 0.05 mm), in rows, compressed: less than 0.3 MB of each scan.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, Process
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.stage_shapes import StageShapes
from isf_core.types import Array, Mask
from numpy.typing import NDArray
from scipy import ndimage

from isf_analysis.measures.deviation import flange_level, regions_of
from isf_analysis.measures.remarks import spans
from isf_analysis.measures.scan_cloud import filled, on_cells, sized

QUANTUM = np.array([1e-5, 1e-5, 1e-6])
"""m, resolution of what is kept."""

MAXIMUM_POINTS = 1 << 16
"""Points kept of one scan; of a larger one every n-th."""

FARTHEST = (1 << 30) - 1
"""Quanta from the origin; what lies beyond (1 km of height, 10 km in plan) is kept as that far."""

ROW = 100
"""Quanta in plan of a row: 1 mm, the spacing of the points of a scanner."""

BORDER = 12e-3
"""m beside the clamp, where the sheet is not formed: the scan is levelled on it."""


@dataclass(frozen=True)
class ContourScan:
    """Points of one scan.

    Attributes
    ----------
    index : contour after which it was made
    time : s, of the process
    count : points kept
    packed : compressed points
    """

    index: int
    time: float
    count: int
    packed: bytes

    def points(self) -> Array:
        """(count, 3) m, frame of the scanner (``sheet`` but for its registration), in rows."""
        planes = np.frombuffer(zlib.decompress(self.packed), dtype=np.uint8).reshape(4, 3 * self.count)
        steps = np.ascontiguousarray(planes.T).view("<i4").reshape(3, self.count)
        return np.asarray(np.cumsum(steps, axis=1).T * QUANTUM)


def kept_scan(index: int, time: float, points: Array) -> ContourScan:
    """What is kept of the scan ``points`` (P, 3) m after contour ``index``; its bad points (NaN) are dropped."""
    points = points[np.isfinite(points).all(axis=1)]
    points = np.clip(points, -FARTHEST * QUANTUM, FARTHEST * QUANTUM)  # of a wrong unit; told by :func:`left_out`
    chosen = points[:: max(1, -(-len(points) // MAXIMUM_POINTS))]
    whole = np.rint(chosen / QUANTUM).astype(np.int32)
    whole = whole[np.lexsort((whole[:, 2], whole[:, 1], whole[:, 0], whole[:, 1] // ROW))]
    steps = np.diff(whole, axis=0, prepend=np.zeros((1, 3), dtype=np.int32)).astype("<i4")
    planes = np.ascontiguousarray(steps.T).view(np.uint8).reshape(-1, 4).T
    packed = zlib.compress(np.ascontiguousarray(planes).tobytes(), 1)
    return ContourScan(index, time, len(chosen), packed)


@dataclass(frozen=True)
class ScanError:
    """The part so far against the target of its stage, where contours have formed it; m, measured minus wanted height.

    Attributes
    ----------
    index : contour after which the scan was made
    error : on the grid of the target, NaN where nothing is formed yet (or one cell beside) or nothing was seen
    coverage : seen share of what is formed
    max_abs, mean_abs, mean : of ``error``
    stage : of the contour, from 0
    """

    index: int
    error: HeightMap
    coverage: float
    max_abs: float
    mean_abs: float
    mean: float
    stage: int = 0


def scan_errors(
    scans: tuple[ContourScan, ...],
    nominal: tuple[Contour, ...],
    target: HeightMap,
    preforms: tuple[HeightMap, ...] = (),
) -> tuple[ScanError, ...]:
    """Errors after each scan, in a stage before the last one against its shape among the ``preforms``. Over a die the
    part so far is the top of the target.

    Scans of contours that are not known, of a wrong unit, or with no point on what is formed are left out: see
    :func:`left_out`.

    Raises
    ------
    IsfError : BAG_INCOMPLETE when the target is flat
    """
    known = {contour.index: contour for contour in nominal}
    shapes = StageShapes(target, preforms)
    openings: dict[int, NDArray[np.int32]] = {}
    found = []
    for scan in scans:
        contour = known.get(scan.index)
        if contour is None or not sized(scan.points(), target):
            continue
        end = shapes.end(contour.stage)
        if id(end) not in openings:
            openings[id(end)], _ = ndimage.label(regions_of(end)["wall_and_base"], structure=np.ones((3, 3)))
        opening = openings[id(end)]
        formed_it = [known[k] for k in sorted(known) if k <= scan.index and shapes.end(known[k].stage) is end]
        wanted, formed = _so_far(end, opening, formed_it)
        # beside what is not formed yet the wall is not finished
        formed &= ~np.asarray(ndimage.binary_dilation((opening > 0) & ~formed, structure=np.ones((3, 3))))
        surface = on_cells(levelled(scan.points(), target), wanted)
        if surface is None or not formed.any():
            continue
        # filled from what is formed alone: the sheet inside stands far above the target
        error = np.where(formed, filled(np.where(formed, surface.z - wanted.z, np.nan)), np.nan)
        values = error[np.isfinite(error)]
        if len(values):
            size = np.abs(values)
            coverage = len(values) / int(formed.sum())
            shape = HeightMap(target.x, target.y, error)
            found.append(
                ScanError(
                    scan.index,
                    shape,
                    coverage,
                    float(size.max()),
                    float(size.mean()),
                    float(values.mean()),
                    contour.stage,
                )
            )
    return tuple(found)


def left_out(
    scans: tuple[ContourScan, ...], errors: tuple[ScanError, ...], nominal: tuple[Contour, ...], target: HeightMap
) -> tuple[str, ...]:
    """Why scans have no error among ``errors``, one sentence per reason with its contours counted from 1."""
    shown, known = {error.index for error in errors}, {contour.index for contour in nominal}
    why: dict[str, list[int]] = {}
    for scan in scans:
        if scan.index in shown:
            continue
        if scan.count == 0:
            reason = "not one finite point"
        elif scan.index not in known:
            reason = "of a contour that was not recorded"
        elif not sized(scan.points(), target):
            reason = "of another size than the part by more than a factor of 5: wrong unit?"
        else:
            reason = "no point on what was formed"
        why.setdefault(reason, []).append(scan.index + 1)
    return tuple(
        f"{len(found)} scan{'s' * (len(found) > 1)} left out of the error after each scan: {reason} "
        f"(after contour {spans(found)})"
        for reason, found in why.items()
    )


def levelled(points: Array, target: HeightMap) -> Array:
    """(P, 3) m, ``points`` less the plane through those beside the clamp (the border of ``target``), if there are any.

    Twice: the second time without points farther from the plane than three standard deviations.
    """
    half = np.array([target.x[-1], target.y[-1]])
    near = points[(half - np.abs(points[:, :2])).min(axis=1) <= BORDER]
    for _ in range(2):
        if len(near) < 100:
            return points
        matrix = np.column_stack([np.ones(len(near)), near[:, :2]])
        plane = np.linalg.lstsq(matrix, near[:, 2], rcond=None)[0]
        away = np.abs(near[:, 2] - matrix @ plane)
        near = near[away <= 3.0 * away.std() + 1e-9]
    down = plane[0] + points[:, :2] @ plane[1:]
    return np.asarray(points - np.column_stack([np.zeros((len(points), 2)), down - flange_level(target)]))


def _so_far(target: HeightMap, opening: NDArray[np.int32], contours: list[Contour]) -> tuple[HeightMap, Mask]:
    """Wanted heights over the flange, and the cells that ``contours`` have formed for good: as far as contact went."""
    last = contours[-1]
    height = target.z - flange_level(target)
    formed = np.zeros(height.shape, dtype=bool)
    if last.process is Process.TPIF:
        over_die = height - float(np.nanmax(height))
        wanted = HeightMap(target.x, target.y, over_die - last.holder_height)
        return wanted, (opening > 0) & (over_die >= last.holder_height)
    with np.errstate(invalid="ignore"):
        for label, level in levels_reached(target, opening, contours).items():
            reached = (height >= level) & (height <= 0.0) if level < 0.0 else (height <= level) & (height >= 0.0)
            formed |= (opening == label) & reached
    return target, formed


def levels_reached(target: HeightMap, opening: NDArray[np.int32], contours: list[Contour]) -> dict[int, float]:
    """m, height of the contact farthest from the flange in every feature, by the number of its ``opening`` (ny, nx)."""
    levels: dict[int, float] = {}
    for contour in contours:
        column = np.rint((contour.contact[:, 0] - target.x[0]) / (target.x[1] - target.x[0])).astype(np.intp)
        row = np.rint((contour.contact[:, 1] - target.y[0]) / (target.y[1] - target.y[0])).astype(np.intp)
        here = opening[np.clip(row, 0, opening.shape[0] - 1), np.clip(column, 0, opening.shape[1] - 1)]
        level = float(np.median(contour.contact[:, 2]))
        for label in np.unique(here[here > 0]):
            known = levels.get(int(label), 0.0)
            levels[int(label)] = level if abs(level) > abs(known) else known
    return levels
