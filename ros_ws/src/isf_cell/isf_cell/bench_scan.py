"""A scan of a part from a bench, in place of one that the cell made: its unit is checked, and it is laid onto the part.

The part is still in the clamp, or out of it (released, trimmed or not). One in the clamp is registered by the sheet
beside the clamp and by its edges, as every scan is (:mod:`isf_springback.scan.registration`); a fit onto the target
only brings it near enough. One out of the clamp has nothing that did not move: its opening and the rim around it are
laid onto the target by least squares of all heights, and in plan by the walls. No point is left out as an outlier
there: where springback is large it would be the part. What a part moved by when it was released (delta_3 of Ren 2018,
eq. 1-1) can be taken out where the same job was formed and released on the simulated sheet; else it stays in the error.
m, frame ``sheet``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from isf_analysis.measures.deviation import RIM_WIDTH, regions_of
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.release import laid_onto, movement_between
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import METRES
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Mask
from isf_springback.scan import registration
from isf_springback.scan.formed_shape import PITCH
from isf_springback.scan.point_cloud import grid_heights
from scipy.spatial.transform import Rotation

from isf_cell.shape_file import load_shape

ALIGNMENTS = ("clamp", "fit")

SAMPLES = 250_000
"""Points taken of a mesh: four in a cell of 1 mm of a sheet of 250 mm."""

SMALLEST, LARGEST = 0.6, 1.6
"""Of the opening, and of the clamp, that a scan extends over: beyond, the unit is wrong (the next ones are inch for cm,
a factor of 2.5)."""

_BRING_NEAR = "bring it within 10 mm and 10 deg of the part, in frame sheet: z up, the middle of the clamp at x = y = 0"

SAME_PART = 0.1e-3
"""m, by which the wanted shapes of two runs of one part may differ."""

LARGEST_MOVE, LARGEST_TURN = 10e-3, np.radians(10.0)
"""m in plan, rad, by which a fit may move the middle of the clamp and turn a scan: farther off it finds another place,
as the flat sheet beside the part (assumed). Height is not bounded: a part may lie on a table."""

ROUNDS = 5
"""Of height and tilt, and of shift in plan, by turns (chosen)."""


@dataclass(frozen=True)
class BenchScan:
    """A scan that was laid onto its part.

    Attributes
    ----------
    points : (P, 3) m, frame ``sheet``; without what the release moved where that is known
    released : the part was out of the clamp
    moved : m, by which the fit moved the middle of the points ; turned : rad
    movement : by the release, m, NaN where not known, that was taken out of the points; None: nothing was
    """

    points: Array
    released: bool
    moved: Array
    turned: float
    movement: HeightMap | None = None


def read_bench_scan(
    path: Path,
    unit: str | None,
    target: HeightMap,
    clamp: tuple[float, float],
    *,
    align: str,
    released: bool,
    like: PartRecord | None = None,
) -> BenchScan:
    """The scan in the file at ``path`` (cloud, mesh, run), laid onto ``target`` in a clamp of ``clamp`` m x m.

    Parameters
    ----------
    unit : of meshes and PLY clouds ; align : "clamp", as it lies, in frame ``sheet``, or "fit"
    released : the part is out of the clamp
    like : record of the same job formed and released on a simulated sheet, whose movement is taken out

    Raises
    ------
    IsfError : codes of :func:`isf_cell.shape_file.load_shape`; SCAN_UNIT_SUSPECT; SCAN_INCOMPLETE, nothing
        fits; SCAN_SHIFTED, it fits too far off; BAG_INCOMPLETE, ``like`` holds no part out of the clamp
    """
    shape = load_shape(path, unit, samples=SAMPLES)
    read = shape.points
    _check_extent(read, target, clamp, path, unit)
    points = read
    if align == "fit":
        try:
            points = on_target(read, target, clamp) if released else in_clamp(read, target, clamp)
        except IsfError as error:
            raise IsfError(
                error.code,
                f"cannot be laid onto the part: {error.what}",
                where=str(path),
                advice=_BRING_NEAR,
            ) from error
    moved, turned, slid = _motion(read, points)
    if slid > LARGEST_MOVE or turned > LARGEST_TURN:
        raise IsfError(
            ErrorCode.SCAN_SHIFTED,
            f"lies on the part only when it is moved by {1e3 * slid:.0f} mm in plan and turned by "
            f"{np.degrees(turned):.0f} deg; {1e3 * LARGEST_MOVE:.0f} mm and {np.degrees(LARGEST_TURN):.0f} deg are "
            "believed",
            where=str(path),
            advice=_BRING_NEAR,
        )
    if released:
        points = points[_near_opening(points, target)]
    if like is None:
        return BenchScan(points, released, moved, turned)
    movement = _movement_of(like, target, clamp, align)
    away = movement.at(points[:, :2])
    known = np.isfinite(away)
    there = points[known] - np.column_stack([np.zeros((int(known.sum()), 2)), away[known]])
    return BenchScan(there, released, moved, turned, movement)


def in_clamp(points: Array, target: HeightMap, clamp: tuple[float, float]) -> Array:
    """(P, 3) m, ``points`` of a part in the clamp near where they belong: registered by sheet and edges of the clamp,
    as far as these are seen, else as :func:`on_target`. Raises IsfError SCAN_INCOMPLETE, nothing fits."""
    points = laid_onto(points, target)
    plane = registration.flange_plane(points, clamp)
    if plane is None:
        return _settled(points, target, clamp)
    points = registration.levelled(points, plane)
    free, framed = registration.without_frame(points, clamp)
    edges = registration.find_edges(free, clamp, framed=framed)
    return _settled(points, target, clamp, level=False) if edges is None else registration.undone(points, edges)


def on_target(points: Array, target: HeightMap, clamp: tuple[float, float]) -> Array:
    """(P, 3) m, ``points`` of a part out of the clamp laid onto ``target``; raises IsfError SCAN_INCOMPLETE."""
    return _settled(laid_onto(points, target), target, clamp)


def _settled(points: Array, target: HeightMap, clamp: tuple[float, float], *, level: bool = True) -> Array:
    """By least squares of the heights of opening and rim (``level``), and by the walls in plan."""
    for _ in range(ROUNDS):
        near = points[_near_opening(points, target)]
        error = near[:, 2] - target.at(near[:, :2])
        known = np.isfinite(error)
        if known.sum() < 500:
            raise IsfError(ErrorCode.SCAN_INCOMPLETE, f"{known.sum()} points lie over the part", where="scan")
        if level:
            matrix = np.column_stack([np.ones(int(known.sum())), near[known, :2]])
            height, tilt_x, tilt_y = np.linalg.lstsq(matrix, error[known], rcond=None)[0]
            plane = registration.FlangePlane(float(height), float(tilt_x), float(tilt_y), 0.0, int(known.sum()))
            points = registration.levelled(points, plane)
        surface, _ = grid_heights(points, clamp, PITCH)
        shift, _ = registration.plan_shift(surface, target)
        points = points - np.append(shift, 0.0)
    return points


def _near_opening(points: Array, target: HeightMap) -> Mask:
    """(P,) bool, over the opening of ``target`` or its rim of 10 mm."""
    near = regions_of(target, rim_width=RIM_WIDTH)
    mask = near["wall_and_base"] | near["rim"]
    return np.asarray(HeightMap(target.x, target.y, mask.astype(np.float64)).at(points[:, :2]) > 0.5)


def _motion(before: Array, after: Array) -> tuple[Array, float, float]:
    """Shift (3,) m of the middle, turn, rad, and shift in plan, m, of what comes to lie at x = y = 0, of the rigid
    motion from ``before`` to ``after`` (P, 3) m."""
    middles = before.mean(axis=0), after.mean(axis=0)
    turn, _ = Rotation.align_vectors((after - middles[1])[::10], (before - middles[0])[::10])
    origin = turn.inv().apply(-middles[1]) + middles[0]
    return middles[1] - middles[0], float(turn.magnitude()), float(np.hypot(*origin[:2]))


def _movement_of(like: PartRecord, target: HeightMap, clamp: tuple[float, float], align: str) -> HeightMap:
    if like.scan is None or like.released is None:
        lacks = "scan in the clamp" if like.scan is None else "scan out of the clamp"
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            f"holds no {lacks}: what a part moves by when it is released is not known from it",
            where="--release-of",
            advice="isf simulate JOB --sheet shell_coarse --release makes such a run",
        )
    other = like.target.z if like.target is not None else np.empty(0)
    if other.shape != target.z.shape or not np.allclose(other, target.z, rtol=0.0, atol=SAME_PART, equal_nan=True):
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            "is of a part of another shape: what it moved by when it was released says nothing of this one",
            where="--release-of",
            advice="give a run of the part that was scanned, or --released, which counts the release as springback",
        )
    # laid onto the target as the scan is, whatever that does to it: what a fit takes from both cancels
    return movement_between(like.scan, on_target(like.released, target, clamp) if align == "fit" else like.released)


def _check_extent(points: Array, target: HeightMap, clamp: tuple[float, float], path: Path, unit: str | None) -> None:
    """Raise IsfError SCAN_UNIT_SUSPECT for points that extend over less than the part, or over more than the clamp."""
    extent = np.sort(np.percentile(points[:, :2], 99, axis=0) - np.percentile(points[:, :2], 1, axis=0))
    opening = regions_of(target)["wall_and_base"]
    part = np.sort([np.ptp(target.x[opening.any(axis=0)]), np.ptp(target.y[opening.any(axis=1)])])

    def fits(size: Array) -> bool:
        return bool((size >= SMALLEST * part).all() and size[1] <= LARGEST * max(clamp))

    if fits(extent):
        return
    table = path.suffix.lower() in (".npz", ".csv")
    told = 1.0 if table or unit is None else METRES[unit]
    other = [name for name, metres in METRES.items() if fits(extent / told * metres)]
    if table:
        advice = "coordinates in NPZ and CSV are in m" + (f"; these are in {other[0]}, it seems" if other else "")
    else:
        advice = f"--unit {other[0]}, it seems" if other else "check --unit"
    raise IsfError(
        ErrorCode.SCAN_UNIT_SUSPECT,
        f"the scan is {_mm(extent)} mm large, the part {_mm(part)} mm, the clamp {_mm(np.sort(clamp))} mm",
        where=str(path),
        advice=f"{advice}; the scan is to show the whole part, and hardly more than the sheet",
    )


def _mm(size: Array) -> str:
    return " x ".join(f"{1e3 * value:.4g}" for value in size[::-1])
