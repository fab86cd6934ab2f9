"""Methods "learned" and "learned_map": corrections from parts formed before (``springback.learning`` of the job).

"learned" replays the correction field of the same part. Where the file holds what scans between contours showed of that
part, and this one is scanned, too, it follows what they show to be different: another sheet springs back more or less.

"learned_map" predicts springback on any part from wall angle, curvature, depth and distance to the floor: a smooth
additive model, the baseline of the published MARS maps (Behera 2015, introduction). Outside of what was learned it
answers with the edge of it, and says so. Both stay inside the limits of every correction.

What error they expect stands on what the file holds: of a try-out the parts that were formed with this very correction
on sheets that differ, their mean and their spread; of a part before, what its correction leaves of its error, and how
much parts of one condition differ; of a map, how far the samples scatter about it.
"""

from __future__ import annotations

from bisect import bisect
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from isf_core.contour import Contour, Process, contour_label, makes_floor
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_springback.estimators import learning
from isf_springback.estimators.estimator import (
    Bounds,
    Estimator,
    FormedContour,
    History,
    Prediction,
    Wall,
    wall_of,
)
from isf_springback.estimators.fused import (
    DRIFT_AFTER_SURPRISE,
    LARGEST_BIAS,
    REPORTED_BIAS,
    BiasField,
    ModelledContour,
    Prior,
    carried,
    expected_error,
    first_field,
    floor_share,
    implausible,
    shift_lever,
    updated,
)
from isf_springback.estimators.learning import FEATURES, Learned, features
from isf_springback.loop_path import LARGEST_CORRECTION, LoopPath, LoopSamples, forming_radii, nearest_points
from isf_springback.scan import FormedShape
from isf_springback.scan.feedback import contour_over_die, target_over_die
from isf_springback.scan.formed_shape import floor_under
from isf_springback.scan.readings import CONTOURS_PER_PLACE, PLACES, READING_DEVIATION, read_errors

FEWEST_SAMPLES = 200
KNOTS = 5
"""Knots of the splines per feature (assumed)."""
RIDGES = tuple(10.0**k for k in range(-2, 4))
"""Weights of the ridge on standardised splines, of which cross-validation chooses."""

Predict = Callable[[Contour, History, list[str]], Array]
Expect = Callable[[Contour], tuple[Array, Array]]
"""(N,) m, error along +z that is expected on a contour, and its standard deviation; (0,) each: not known."""

SHEETS_DIFFER = Prior(0.3e-3, 0.8, 0.2e-3)
"""Of springback on one sheet beyond that on another (assumed: parts of one condition differ by 0.2 mm, as the measured
cones of docs/methods/shell_sheet.md do; by strength and thickness they do so all around; where the tool is in the clamp
is known to some tenths of a millimetre)."""
TOUCHING = 0.2e-3
"""m between ball and sheet in a scan up to which the ball is believed to have formed the place (assumed: more than a
scan is wrong by)."""
NOTHING_SEEN = (
    "the file of the part before holds no scans between contours: those of this one change nothing (isf learn adds "
    "them, for the next)"
)


class LearnedEstimator(Estimator):
    """Predicts what ``predict`` says of a contour and, with ``before``, the same part formed before, what scans show to
    differ from it; ``check`` raises where the file does not belong to its plan, ``expect`` tells the error to come."""

    open_loop = True

    def __init__(
        self,
        name: str,
        job_file: JobFile,
        predict: Predict,
        expect: Expect,
        check: Callable[[Contour], None] = lambda _: None,
        before: Learned | None = None,
    ) -> None:
        super().__init__(job_file)
        self.name = name
        self._predict = predict
        self._expect = expect
        self._check = check
        self._replays = before is not None
        self._beside_limits = before is not None and before.tried is None  # parts that were tried met the same limits
        self._difference: Difference | None = None
        if before is not None and job_file.job.springback.scan_every and job_file.job.process != "TPIF":
            self.uses_scans = True
            self._difference = Difference(before, job_file)

    def begin(self, contour: Contour, history: History) -> None:
        """As the base class; raises LEARNING_UNUSABLE."""
        self._check(contour)
        if self._difference is not None:
            self._difference.begin(contour)

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """As the base class."""
        remarks: list[str] = []
        push = self._predict(contour, history, remarks)
        left, spread = self._expect(contour)
        fault: IsfError | None = None
        if self._difference is not None:
            bias, spread = self._difference.along(contour, history)
            remarks += self._difference.remarks
            if np.abs(bias).max() >= REPORTED_BIAS:
                far = 1e3 * float(bias[np.argmax(np.abs(bias))])
                remarks.append(f"scans show {far:+.1f} mm of springback relative to the part before")
            push = push + np.clip(bias, -LARGEST_BIAS, LARGEST_BIAS)
            fault = history.scans.fault_before(contour)
        return Prediction(
            push,
            push if self._replays else None,  # a part before was pushed by so much: no gain of a model applies to it
            deviation=spread,
            expected_error=left,
            beside_limits=self._beside_limits,
            remarks=tuple(remarks),
            fault=fault,
        )

    def bounds(self, contour: Contour, history: History) -> Bounds:
        """Parts formed before may have come out too deep; of the same one the passes over a floor are known, too."""
        return Bounds(pulls_back=True, at_floor=False, replays_floor=self._replays)

    def add_formed(self, formed: FormedContour, history: History) -> None:
        """As the base class; asking again for a contour replaces it."""
        if self._difference is not None:
            self._difference.add_formed(formed)

    def add_shape(self, shape: FormedShape | None, history: History) -> None:
        """Update the difference from the part before."""
        if self._difference is not None:
            self._difference.add_shape(shape, history)


@dataclass
class _WallDifference:
    """What is known of one wall: ``wall`` and ``bottom`` biases, the contours that made it in reach of the scan
    (``steps``), and whether a bottom was ever seen (``has_bottom``); of the newest scan ``remarks`` and the share of
    ``doubtful`` places; the height m of the ``floor`` that it ends in, None until it is asked for."""

    wall: BiasField | None = None
    bottom: BiasField | None = None
    steps: list[ModelledContour] = field(default_factory=list)
    doubtful: float = 0.0
    remarks: tuple[str, ...] = ()
    floor: float | None = None
    has_bottom: bool = False


class Difference:
    """What scans show of this part that the same scans of the part before, in ``before``, did not show.

    A contour pushed deeper than then is expected to leave the wall deeper by as much. What is measured beyond that is
    the bias of :mod:`isf_springback.estimators.fused`: of the wall, and where the last contours make the floor, of
    the bottom. What a wall still does once the contact has passed was learned with the correction.
    """

    def __init__(self, before: Learned, job_file: JobFile) -> None:
        self._before = before
        self._seen = _seen_everywhere(before)
        self._radius = forming_radii(job_file)
        self._plan_id = ""
        self._walls: dict[Wall, _WallDifference] = defaultdict(_WallDifference)
        self._now = _WallDifference()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person should know of the newest scan of the wall in work."""
        return self._now.remarks

    def begin(self, contour: Contour) -> None:
        """``contour`` is next; a difference is one of one wall, formed from one side."""
        if contour.plan_id != self._plan_id:
            self._walls.clear()
        self._plan_id = contour.plan_id
        self._now = self._walls[wall_of(contour)]

    def along(self, contour: Contour, history: History) -> tuple[Array, Array]:
        """(N,) m, springback of ``contour`` beyond that of the part before, and its standard deviation."""
        samples = LoopSamples.of(contour, PLACES)
        wall, bottom = self._fields(self._now, contour, samples.contact[:, :2])
        on_wall, on_floor, wall_deviation, floor_deviation = samples.along(
            wall.bias, bottom.bias, wall.deviation, bottom.deviation
        )
        share, target = np.zeros(len(contour)), history.scans.target
        unseen = history.scans.began is not None and not self._now.has_bottom  # the stage before has made it
        if contour.floor_passes:
            share += makes_floor(contour)
        elif target is not None and not unseen:
            if self._now.floor is None:
                self._now.floor = floor_under(target, contour)
            share = floor_share(contour, self._now.floor, self._radius[contour.forming_tool])
        return (1.0 - share) * on_wall + share * on_floor, np.maximum(wall_deviation, floor_deviation)

    def add_formed(self, formed: FormedContour) -> None:
        """The contour is formed so."""
        contour = formed.contour
        place, applied = self._known(contour, self._before.applied)
        then = _along(contour, place, applied)
        earlier = [step for step in self._now.steps if step.contour.index < contour.index]
        self._now.steps = [*earlier[1 - CONTOURS_PER_PLACE :], ModelledContour(contour, formed.push, then)]

    def add_shape(self, shape: FormedShape | None, history: History) -> None:
        """The shape measured after the contour in work: of every wall that was formed since the scan before."""
        current, target = history.current, history.scans.target
        if shape is None or current is None or target is None or current.contour.forming_tool != 1:
            return
        for wall, formed in history.shown.items():
            self._read(self._walls[wall], formed, shape, target, history)

    # -- inside --------------------------------------------------------------------------------------

    def _read(
        self, now: _WallDifference, current: FormedContour, shape: FormedShape, target: HeightMap, history: History
    ) -> None:
        """Update what is known of one wall, of which ``current`` was formed last."""
        contour = current.contour
        reading = read_errors(contour, shape, target, self._radius[contour.forming_tool], history.scans.began)
        noise = np.full(len(reading.place), float(np.hypot(READING_DEVIATION, shape.noise)))
        place, seen = self._known(contour, self._seen)
        then = seen[nearest_points(reading.place, place)]
        wall, bottom = self._fields(now, contour, reading.place)
        last = now.steps[-1]
        near = nearest_points(reading.place, contour.forming_tip[:, :2])
        now.wall = wall
        if not current.over_floor:  # which says nothing of the wall
            surprise = reading.wall - then[:, 0] - expected_error(now.steps, reading.place)
            now.wall, doubt = updated(wall, surprise, noise)
            now.doubtful = float(doubt.mean())
        surprise = reading.bottom - then[:, 1] - (last.model - last.pushed)[near]
        now.bottom, _ = updated(bottom, surprise, noise)
        now.has_bottom |= bool(np.isfinite(surprise).any())
        nothing = () if self._before.seen is not None else (NOTHING_SEEN,)
        now.remarks = (*shape.remarks, *nothing, *implausible(now.doubtful))

    def _fields(self, now: _WallDifference, contour: Contour, place: Array) -> tuple[BiasField, BiasField]:
        """Both biases at ``place`` (M, 2) m of ``contour`` of the wall ``now``, one contour later than last time."""
        drift = 1.0 + DRIFT_AFTER_SURPRISE * now.doubtful
        lever = shift_lever(contour, place)
        if now.wall is None or now.bottom is None:
            return first_field(place, SHEETS_DIFFER, lever), first_field(place, SHEETS_DIFFER)
        wall = carried(now.wall, place, drift, SHEETS_DIFFER, lever)
        return wall, carried(now.bottom, place, drift, SHEETS_DIFFER)

    def _known(self, contour: Contour, values: Array) -> tuple[Array, Array]:
        """Places (M, 2) m of ``contour`` in the file, and ``values`` (K, ...) of them."""
        rows = self._before.contour == contour.index
        return self._before.place[rows], values[rows]


def _seen_everywhere(before: Learned) -> Array:
    """(K, 2) m, what was seen, between the contours that were scanned as well; NaN where a place never was, and where
    the contours that made it passed over the sheet, as a path may that was led back."""
    if before.seen is None:
        return np.full((len(before.contour), 2), np.nan)
    seen = before.seen.copy()
    rows_of = {int(k): np.flatnonzero(before.contour == k) for k in np.unique(before.contour)}
    scanned = [k for k, rows in rows_of.items() if np.isfinite(seen[rows]).any()]
    for k, rows in rows_of.items():
        if k in scanned or not scanned:
            continue
        after = bisect(scanned, k)
        around = scanned[max(after - 1, 0) : after + 1]
        theirs = [rows_of[other] for other in around]
        values = [seen[r[nearest_points(before.place[rows], before.place[r])]] for r in theirs]
        share = 0.0 if len(around) == 1 else (k - around[0]) / (around[1] - around[0])
        seen[rows] = (1.0 - share) * values[0] + (share * values[-1] if share else 0.0)
    over_sheet = [k for k, rows in rows_of.items() if _median(before.applied[rows] + seen[rows, 0]) < -TOUCHING]
    for k in over_sheet:
        seen[(before.contour >= k) & (before.contour < k + CONTOURS_PER_PLACE)] = np.nan
    return seen


def _median(values: Array) -> float:
    """Of those that are known; NaN where none is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def _along(contour: Contour, place: Array, values: Array) -> Array:
    """(N,) ``values`` (M,), known at ``place`` (M, 2) m, along ``contour``."""
    path = LoopPath.of(contour)
    position = path.position[nearest_points(place, contour.contact[:, :2])]
    order = np.argsort(position)
    period = path.length if path.closed else None
    return np.asarray(np.interp(path.position, position[order], values[order], period=period))


def learned(job_file: JobFile) -> LearnedEstimator:
    """Method "learned"; raises IsfError LEARNING_UNUSABLE."""
    known = knowledge(job_file)

    def check(contour: Contour) -> None:
        away = learning.misplaced(known, contour)
        if contour.count != known.contours or not np.isfinite(away):
            why = f"was learned on a plan of {known.contours} contours, this one has {contour.count}"
            if contour.floor_passes and contour.count > known.contours:
                why += " with its passes over the floor (path.floor_step: none leaves them out)"
        elif away > learning.SAME_PLACE:
            why = (
                f"was learned on another plan, on which {contour_label(contour.index)} runs up to {1e3 * away:.1f} mm "
                "elsewhere: another part, or one that was moved or turned"
            )
        else:
            return
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            why,
            where=f"springback.learning: {job_file.job.springback.learning}",
            advice="learn from parts of this plan, or use learned_map",
        )

    def predict(contour: Contour, history: History, remarks: list[str]) -> Array:
        return _along(contour, *known.of_contour(contour.index))

    return LearnedEstimator("learned", job_file, predict, lambda contour: left_by(known, contour), check, known)


def learned_map(job_file: JobFile) -> LearnedEstimator:
    """Method "learned_map"; raises IsfError LEARNING_UNUSABLE."""
    known = knowledge(job_file)
    fitted = fit_map(known)
    model, low, high, smallest, largest = fitted.model, fitted.low, fitted.high, fitted.smallest, fitted.largest

    def predict(contour: Contour, history: History, remarks: list[str]) -> Array:
        target = history.scans.target
        if target is None:
            raise IsfError(
                ErrorCode.CORRECTION_FAILED,
                "the target shape is not known, and with it how far the floor is",
                where=contour_label(contour.index),
                advice="the planner publishes part/target; without it the last good correction is kept",
            )
        if contour.process is Process.TPIF:  # depths of samples count from the top of the die
            target, contour = target_over_die(target), contour_over_die(contour)
        row = features(contour, floor_under(target, contour))
        inside = np.clip(row, low, high)
        far = np.abs(row - inside) > 0.05 * np.maximum(high - low, 1e-9)
        for k in np.flatnonzero(far.any(axis=0)):
            remarks.append(f"{FEATURES[k]} is outside the learned range: the value at its edge is used")
        return np.clip(model.predict(inside), max(smallest, -LARGEST_CORRECTION), min(largest, LARGEST_CORRECTION))

    def expect(contour: Contour) -> tuple[Array, Array]:
        return np.empty(0), np.full(len(contour), fitted.deviation)

    return LearnedEstimator("learned_map", job_file, predict, expect)


def left_by(known: Learned, contour: Contour) -> tuple[Array, Array]:
    """(N,) m, error along +z that parts with the correction in ``known`` leave on ``contour``, and its standard
    deviation from part to part; (0,) each where no part was seen there."""
    rows = known.contour == contour.index
    if known.tried is not None:
        parts = known.tried[:, rows]
        seen = np.isfinite(parts).all(axis=0)
        error, several = parts.mean(axis=0), len(parts) > 1
        spread = parts.std(axis=0, ddof=1) if several else np.full(len(error), SHEETS_DIFFER.deviation)
    else:
        error = -contour.push_sign * (known.error + known.applied - known.push)[rows]
        seen, spread = np.isfinite(error), np.full(len(error), SHEETS_DIFFER.deviation)
    if not seen.any():
        return np.empty(0), np.empty(0)
    place = known.place[rows][seen]
    return _along(contour, place, error[seen]), _along(contour, place, spread[seen])


def knowledge(job_file: JobFile) -> Learned:
    """The file named in the job; raises IsfError LEARNING_UNUSABLE."""
    name = job_file.job.springback.learning
    if name is None:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            "the job names no file",
            where="springback.learning",
            advice=learning.MADE_BY,
        )
    return learning.load(job_file.base / name)


@dataclass(frozen=True)
class FittedMap:
    """Springback, m, over the features: the ``model``, the range ``low`` (4,) to ``high`` (4,) of the features, and
    ``smallest`` to ``largest`` m of springback that it was fitted to; ``deviation`` m, root mean square of how far
    samples that are left out lie from it, one at a time."""

    model: Any
    low: Array
    high: Array
    smallest: float
    largest: float
    deviation: float


def fit_map(known: Learned) -> FittedMap:
    """Model of springback fitted to the samples in ``known``.

    Raises
    ------
    IsfError : LEARNING_UNUSABLE, too few samples
    """
    from sklearn.linear_model import RidgeCV  # late: half a second that other methods need not pay
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import SplineTransformer, StandardScaler

    if len(known.springback) < FEWEST_SAMPLES:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            f"holds {len(known.springback)} samples, {FEWEST_SAMPLES} are needed",
            where="springback.learning",
            advice="learn from whole parts",
        )
    low, high = np.quantile(known.feature, [0.01, 0.99], axis=0)
    splines = SplineTransformer(n_knots=KNOTS, degree=2, extrapolation="constant", include_bias=False)
    model = make_pipeline(StandardScaler(), splines, RidgeCV(alphas=RIDGES))
    model.fit(np.clip(known.feature, low, high), known.springback)
    smallest, largest = np.quantile(known.springback, [0.01, 0.99])
    # the score of a ridge is the negative mean square of what it misses each sample by that it was not fitted to
    return FittedMap(model, low, high, float(smallest), float(largest), float(np.sqrt(-model[-1].best_score_)))
