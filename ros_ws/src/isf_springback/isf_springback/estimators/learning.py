"""Iterative learning from part to part: the correction field of the next part from the shape of the last one.

Displacement adjustment: where a place is too high after the part, it is pushed deeper on the next one,
``push <- push + gain error`` (mirror correction with a factor, Lu 2016, 2.3.3). Robust in three ways: the gain is
below 1; a place whose error did not follow the last change (bending of the rim, for example) is left alone; change and
size are bounded.

What was learned from formed parts, in one file: the correction of every contour, and samples of springback.

The file is numpy's npz without pickled objects; lengths in m. The correction field belongs to one part (job and plan);
the samples, springback with wall angle, curvature and distance to the rim, carry over to other parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from isf_core.contour import Contour, ContourCorrection, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.archive import read_archive
from isf_core.files.bounded import reason
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.stage_shapes import StageShapes
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.loop_path import LARGEST_CORRECTION, LoopPath, nearest_points
from isf_springback.scan import FormedShape, ScanExpectation, process_scan
from isf_springback.scan.feedback import contour_over_die, shape_over_die, target_over_die, turned_shape
from isf_springback.scan.formed_shape import ANY_SCALE, floor_under
from isf_springback.scan.readings import read_errors

FORMAT = 1
MADE_BY = "make it with: isf learn RUN... -o FILE, or isf tryout JOB"
"""Advice where a file is missing or not one of these."""
FEATURES = (
    "wall angle [rad]",
    "curvature of the contour [1/m]",
    "depth of the contact [m]",
    "distance to the floor [m]",
)


OPTIONAL = ("seen", "tried")
"""Arrays that a file may lack."""


@dataclass(frozen=True)
class Learned:
    """Knowledge from the parts formed so far; K rows are places on contours, S rows are samples.

    Attributes
    ----------
    job : name of the job ; contours : number of contours of its plan ; parts : parts learned from
    contour : (K,) index ; place : (K, 2) m, contact in plan view
    push : (K,) m, correction along the push for the next part ; applied : (K,) m, that of the last part
    error : (K,) m, by which the last part was not pushed far enough there: formed minus target height, and the reverse
        of what is formed from below; NaN where not seen
    gain : (K,) part of the error that is put into the next correction
    feature : (S, 4), see :data:`FEATURES` ; springback : (S,) m
    history : (P, 2) m, mean and largest error of the wall and floor below the rim, per part
    seen : (K, 2) m, such errors of the wall just beside the contact and of the bottom inside the tip, in the scan made
        after that contour of the last part; NaN where nothing was seen. None: no scans were made between its contours
    tried : (V, K) m, error along +z of V parts that were formed with ``push``, as a try-out forms them on sheets that
        differ; NaN where not seen. None: none was
    source : what the last part was formed on, for people; empty: not known
    """

    job: str
    contours: int
    parts: int
    contour: NDArray[np.int64]
    place: Array
    push: Array
    applied: Array
    error: Array
    gain: Array
    feature: Array
    springback: Array
    history: Array
    seen: Array | None = None
    tried: Array | None = None
    source: str = ""

    @property
    def scanned(self) -> int:
        """Contours of the last part after which a scan was made that could be used."""
        if self.seen is None:
            return 0
        return len(np.unique(self.contour[np.isfinite(self.seen).any(axis=1)]))

    def of_contour(self, index: int) -> tuple[Array, Array]:
        """Places (M, 2) m and push (M,) m of contour ``index``."""
        rows = self.contour == index
        return self.place[rows], self.push[rows]


def save(learned: Learned, path: Path) -> None:
    """Write ``learned``; raises IsfError FILE_NOT_WRITABLE."""
    values: dict[str, Any] = {name: np.asarray(value) for name, value in vars(learned).items() if value is not None}
    try:
        with path.open("wb") as stream:
            np.savez_compressed(stream, format=np.asarray(FORMAT), **values)
    except OSError as error:
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, f"cannot be written: {error}", where=str(path)) from error


def load(path: Path) -> Learned:
    """Read a file of :func:`save`; raises IsfError LEARNING_UNUSABLE."""
    advice = MADE_BY
    try:
        data = read_archive(path)
        if int(data["format"]) != FORMAT:
            raise ValueError(f"format {int(data['format'])}, this software reads {FORMAT}")
        always = [name for name in Learned.__dataclass_fields__ if name not in (*OPTIONAL, "source")]
        values: dict[str, Any] = {name: data[name] for name in always}
        for name in OPTIONAL:
            found = data.get(name)
            values[name] = None if found is None else np.where(np.isfinite(found), found, np.nan)
        values |= {
            "source": str(data.get("source", "")),
            "job": str(values["job"]),
            "contours": int(values["contours"]),
            "parts": int(values["parts"]),
        }
        learned = Learned(**values)
        rows, samples = len(learned.contour), len(learned.springback)
        shapes = [
            learned.place.shape == (rows, 2),
            learned.push.shape == (rows,),
            learned.applied.shape == (rows,),
            learned.error.shape == (rows,),
            learned.seen is None or learned.seen.shape == (rows, 2),
            learned.tried is None or (len(learned.tried) > 0 and learned.tried.shape[1:] == (rows,)),
            learned.feature.shape == (samples, 4),
        ]
        needed = ("place", "push", "applied", "feature", "springback")
        finite = all(np.isfinite(getattr(learned, name)).all() for name in needed)
    except (OSError, ValueError, KeyError, TypeError) as error:  # arrays of other types and shapes
        what = f"cannot be used: {reason(error)}"
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, what, where=str(path), advice=advice) from error
    if not all(shapes) or not finite:
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, "its arrays do not fit together", where=str(path), advice=advice)
    return learned


GAIN = 0.7
"""Part of an error that is put into the next part (assumed; 1 is the published mirror correction)."""
LEAST_PUSH = -4e-3
"""m, how far a path is led back where parts come out too deep (assumed)."""
LARGEST_CHANGE = 2e-3
"""m from part to part (assumed)."""
MINIMUM_RESPONSE = 0.3
"""Change of the error over the change of the push below which a place is not moved any more (assumed)."""
NOTICEABLE = 0.15e-3
"""m of change of the push below which its effect cannot be told from the scatter of parts."""
SAME_PLACE = 1e-3
"""m in plan; farther from its contour than this a place belongs to another plan, as a control point does."""
BETWEEN = 0.25e-3
"""m between the points of a contour that a place is compared with: a plan may have few of them."""
FULL_HEIGHT = 1.0 - np.cos(np.radians(50.0))
"""Height of the contact over the tip in tool radii on a common wall: the last contours below it make the floor."""


def learn_part(
    nominal: Sequence[Contour],
    corrections: Sequence[ContourCorrection],
    scan: Array,
    target: HeightMap,
    clamp: tuple[float, float],
    radius: float,
    job: str,
    known: Learned | None = None,
    shapes: Mapping[int, FormedShape] = MappingProxyType({}),
    preforms: Sequence[HeightMap] = (),
    *,
    clamped: bool = True,
    least_scale: float = ANY_SCALE,
) -> Learned:
    """Knowledge after one more part.

    Parameters
    ----------
    nominal, corrections : of every contour, in order ; scan : (P, 3) m, points of the finished part in the clamp, the
    flange at z = 0, over a die as well
    clamped : the scan is of the part in the clamp; else of the part out of it, which lies on its target already
    radius : m, of the forming tool ; known : from earlier parts of the same plan, or of other ones (samples only)
    shapes : scanned after some of the contours, by their index
    preforms : what the stages before the part end with, on the grid of ``target``: the finished part does not tell
        their errors, and their contours are corrected as they were
    least_scale : smallest depth of the scan over that of the part, ``scan.formed_shape.ANY_SCALE`` or ``FORMED_SCALE``

    Raises
    ------
    IsfError : LEARNING_UNUSABLE (incomplete part), codes of :func:`isf_springback.scan.process_scan`
    """
    if not nominal or len(nominal) != nominal[0].count or len(corrections) != len(nominal):
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            f"{len(nominal)} contours and {len(corrections)} corrections are not a complete part",
            where=job,
            advice="learn from parts that were formed to the end",
        )
    if nominal[-1].process is Process.TPIF:
        # the flange moves from contour to contour: contours, target and shape meet in the frame of the die
        shape = shape_over_die(scan, target, clamp, nominal[-1], clamped=clamped, least_scale=least_scale)
        target, nominal = target_over_die(target), [contour_over_die(contour) for contour in nominal]
    elif all(contour.forming_tool == 2 for contour in nominal):
        shape = turned_shape(scan, target, clamp, clamped=clamped, least_scale=least_scale)
    else:
        lowest = min(float(contour.forming_tip[:, 2].min()) for contour in nominal)
        expected = ScanExpectation(target, clamp, lowest, clamped=clamped, least_scale=least_scale)
        shape = process_scan(scan, expected)
    index, place, applied, error, feature, seen = [], [], [], [], [], []
    stages = StageShapes(target, tuple(preforms))
    for contour, correction in zip(nominal, corrections, strict=True):
        wanted = stages.end(contour.stage)
        reading = read_errors(contour, shape, wanted, radius, finished=True)
        near = nearest_points(reading.place, contour.forming_tip[:, :2])
        floor, too_little = floor_under(wanted, contour), -contour.push_sign
        left = np.abs(contour.forming_tip[near, 2] - floor)
        share = np.where(np.isfinite(reading.bottom), np.clip(1.0 - left / (FULL_HEIGHT * radius), 0.0, 1.0), 0.0)
        bottom = np.where(np.isfinite(reading.bottom), reading.bottom, 0.0)
        wall = np.where(np.isfinite(reading.wall), reading.wall, np.where(share > 0.99, 0.0, np.nan))
        index.append(np.full(len(near), contour.index))
        place.append(reading.place)
        applied.append(contour.push_sign * np.asarray(correction.offset)[near, 2])
        of_part = too_little * ((1.0 - share) * wall + share * bottom)
        error.append(np.full(len(near), np.nan) if contour.stage < len(preforms) else of_part)
        feature.append(features(contour, floor)[near])
        then, nothing = None, np.full((len(near), 2), np.nan)
        if contour.index in shapes:
            then = read_errors(contour, shapes[contour.index], wanted, radius, stages.begin(contour.stage))
        seen.append(nothing if then is None else too_little * np.column_stack([then.wall, then.bottom]))
    before = known if known is not None and known.job == job and _of_plan(known, nominal) else None
    now = Learned(
        job,
        len(nominal),
        1 + (before.parts if before is not None else 0),
        np.concatenate(index).astype(np.int64),
        np.concatenate(place),
        np.zeros(sum(map(len, place))),
        np.concatenate(applied),
        np.concatenate(error),
        np.full(sum(map(len, place)), GAIN),
        np.concatenate(feature),
        np.zeros(0),
        np.zeros((0, 2)),
        np.vstack(seen) if shapes else None,
    )
    return _with_samples(_adjusted(now, before), known)


def error_by_place(place: Array, error: HeightMap) -> Array:
    """(K,) m, mean ``error`` around each ``place`` (K, 2) m, over the cells nearest to it; NaN where there is none.

    The place nearest to the largest error has that one, which a mean would hide.
    """
    known = np.isfinite(error.z).ravel()
    values, cells = error.z.ravel()[known], error.points()[known, :2]
    if not len(values):
        return np.full(len(place), np.nan)
    nearest = nearest_points(cells, place)
    count = np.bincount(nearest, minlength=len(place))
    total = np.bincount(nearest, values, minlength=len(place))
    found = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    worst = int(np.argmax(np.abs(values)))
    found[nearest[worst]] = values[worst]
    return found


def misplaced(known: Learned, contour: Contour) -> float:
    """m, largest distance in plan of the places of ``known`` on this contour from where ``contour`` runs; infinite
    where there are none."""
    place, _ = known.of_contour(contour.index)
    if not len(place):
        return float("inf")
    path = LoopPath.of(contour)
    position = path.even_positions(int(np.ceil(path.length / BETWEEN)))
    runs = np.column_stack([path.at(contour.contact[:, axis], position) for axis in (0, 1)])
    return float(np.linalg.norm(place - runs[nearest_points(place, runs)], axis=1).max())


def _of_plan(known: Learned, nominal: Sequence[Contour]) -> bool:
    """True when ``known`` was learned on the contours ``nominal``, all of a plan."""
    return known.contours == len(nominal) and all(misplaced(known, contour) <= SAME_PLACE for contour in nominal)


def features(contour: Contour, floor: float) -> Array:
    """(N, 4) features of the points of a contour, see :data:`isf_springback.estimators.learning.FEATURES`.

    Depth counts along the push, so that of a feature formed from below as well, to its ``floor`` (m, its top). Over a
    die ``contour`` and ``floor`` are those of the frame of the die, in which depth counts from its top.
    """
    depth = contour.push_sign * contour.contact[:, 2]
    return np.column_stack([contour.wall_angle, curvature(contour), depth, contour.push_sign * floor - depth])


def curvature(contour: Contour) -> Array:
    """(N,) 1/m, of the path in plan view, smoothed over 5 mm; positive where it bends like the whole loop."""
    path = LoopPath.of(contour)
    count = max(16, round(path.length / 1e-3))
    step = path.length / count
    grid = step * np.arange(count, dtype=np.float64)
    x, y = path.at(contour.forming_tip[:, 0], grid), path.at(contour.forming_tip[:, 1], grid)
    angle = np.unwrap(np.arctan2(np.roll(y, -1) - np.roll(y, 1), np.roll(x, -1) - np.roll(x, 1)))
    total = float(np.sign(angle[-1] - angle[0])) or 1.0
    turn = np.mod(np.roll(angle, -1) - np.roll(angle, 1) + np.pi, 2 * np.pi) - np.pi
    width = min(count, 5)
    kernel = np.ones(width) / width
    padded = np.concatenate([turn[-width:], turn, turn[:width]])
    smooth = np.convolve(padded, kernel, mode="same")[width:-width]
    return np.asarray(np.interp(path.position, grid, total * smooth / (2 * step)))


def _adjusted(now: Learned, before: Learned | None) -> Learned:
    """``now`` with the push of the next part and the history."""
    gain = now.gain.copy()
    push_before = now.applied
    if before is not None:
        old_error, old_applied, old_gain = _earlier(now, before)
        change = now.applied - old_applied
        moved = np.abs(change) > NOTICEABLE
        with np.errstate(invalid="ignore", divide="ignore"):
            response = (old_error - now.error) / change
        deaf = moved & np.isfinite(response) & (response < MINIMUM_RESPONSE)
        gain = np.where(deaf, 0.5 * old_gain, np.minimum(old_gain, GAIN))
        # overshoot: the error changed its sign and more than the change asked for
        gain = np.where(moved & np.isfinite(response) & (response > 1.4), 0.7 * gain, gain)
    step = np.clip(gain * np.nan_to_num(now.error), -LARGEST_CHANGE, LARGEST_CHANGE)
    push = np.clip(push_before + step, LEAST_PUSH, LARGEST_CORRECTION)
    known = now.error[np.isfinite(now.error) & (now.feature[:, 2] > 3e-3)]
    row = [float(np.abs(known).mean()), float(np.abs(known).max())] if len(known) else [np.nan, np.nan]
    history = np.vstack([before.history, [row]]) if before is not None else np.array([row])
    return replace(now, push=push, gain=gain, history=history)


def together(several: Sequence[Learned]) -> Learned:
    """Knowledge of one plan from parts formed on several sheets: the mean of what each of them asks for and showed.

    Raises
    ------
    IsfError : LEARNING_UNUSABLE, the parts are of different plans
    """
    first = several[0]
    if any((other.job, other.contours) != (first.job, first.contours) for other in several):
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE, "parts of different plans", where=first.job, advice="take parts of one job"
        )
    nearest = [_nearest(first, other) for other in several]
    push = np.mean([other.push[rows] for other, rows in zip(several, nearest, strict=True)], axis=0)
    seen = [other.seen[rows] for other, rows in zip(several, nearest, strict=True) if other.seen is not None]
    return replace(first, push=push, seen=np.mean(seen, axis=0) if seen else None)


def _earlier(now: Learned, before: Learned) -> tuple[Array, Array, Array]:
    """Error, push and gain of ``before`` at the places of ``now``."""
    nearest = _nearest(now, before)
    return before.error[nearest], before.applied[nearest], before.gain[nearest]


def _nearest(now: Learned, other: Learned) -> NDArray[np.intp]:
    """(K,) rows of ``other`` nearest to the places of ``now`` on the same contour."""
    nearest = np.zeros(len(now.contour), dtype=np.intp)
    for index in np.unique(now.contour):
        mine, theirs = np.flatnonzero(now.contour == index), np.flatnonzero(other.contour == index)
        if len(theirs):
            nearest[mine] = theirs[nearest_points(now.place[mine], other.place[theirs])]
    return nearest


def _with_samples(now: Learned, known: Learned | None) -> Learned:
    """Springback samples: what would have to be pushed for no error; older ones are kept, newest first, bounded."""
    seen = np.isfinite(now.error)
    feature, springback = now.feature[seen], (now.applied + now.error)[seen]
    if known is not None:
        feature = np.vstack([feature, known.feature])[:MAXIMUM_SAMPLES]
        springback = np.concatenate([springback, known.springback])[:MAXIMUM_SAMPLES]
    return replace(now, feature=feature, springback=springback)


MAXIMUM_SAMPLES = 20_000
"""Samples kept in a file: a dozen parts."""
