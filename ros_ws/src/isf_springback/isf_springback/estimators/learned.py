"""Methods "learned" and "learned_map": corrections from parts formed before (``springback.learning`` of the job).

"learned" replays the correction field of the same part. "learned_map" predicts springback on any part from wall
angle, curvature, depth and distance to the floor: a smooth additive model, the baseline of the published MARS maps
(Behera 2015, introduction). Both stay inside the limits of every correction; outside of what was learned the map
answers with the edge of it, and says so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array

from isf_springback.estimators import learning
from isf_springback.estimators.estimator import Bounds, Estimator, History, Prediction
from isf_springback.estimators.learning import FEATURES, Learned, features
from isf_springback.loop_path import LARGEST_CORRECTION, LoopPath, nearest_points
from isf_springback.scan.feedback import contour_over_die

FEWEST_SAMPLES = 200
KNOTS = 5
"""Knots of the splines per feature (assumed)."""
RIDGES = tuple(10.0**k for k in range(-2, 4))
"""Weights of the ridge on standardised splines, of which cross-validation chooses."""

Predict = Callable[[Contour, list[str]], Array]


class LearnedEstimator(Estimator):
    """Predicts what ``predict`` says of a contour; ``check`` raises where the file does not belong to its plan."""

    def __init__(
        self, name: str, job_file: JobFile, predict: Predict, check: Callable[[Contour], None] = lambda _: None
    ) -> None:
        super().__init__(job_file)
        self.name = name
        self._predict = predict
        self._check = check

    def begin(self, contour: Contour, history: History) -> None:
        """As the base class; raises LEARNING_UNUSABLE."""
        self._check(contour)

    def estimate(self, contour: Contour, history: History) -> Prediction:
        """As the base class."""
        remarks: list[str] = []
        return Prediction(self._predict(contour, remarks), remarks=tuple(remarks))

    def bounds(self, contour: Contour, history: History) -> Bounds:
        """Parts formed before may have come out too deep."""
        return Bounds(pulls_back=True, at_floor=False)


def learned(job_file: JobFile) -> LearnedEstimator:
    """Method "learned"; raises IsfError LEARNING_UNUSABLE."""
    known = knowledge(job_file)

    def check(contour: Contour) -> None:
        if contour.count != known.contours or not len(known.of_contour(contour.index)[0]):
            raise IsfError(
                ErrorCode.LEARNING_UNUSABLE,
                f"was learned on a plan of {known.contours} contours, this one has {contour.count}",
                where="springback.learning",
                advice="learn from parts of this plan, or use learned_map",
            )

    def predict(contour: Contour, remarks: list[str]) -> Array:
        place, push = known.of_contour(contour.index)
        path = LoopPath.of(contour)
        position = path.position[nearest_points(place, contour.contact[:, :2])]
        order = np.argsort(position)
        period = path.length if path.closed else None
        return np.asarray(np.interp(path.position, position[order], push[order], period=period))

    return LearnedEstimator("learned", job_file, predict, check)


def learned_map(job_file: JobFile) -> LearnedEstimator:
    """Method "learned_map"; raises IsfError LEARNING_UNUSABLE."""
    known = knowledge(job_file)
    model, low, high, smallest, largest = fit_map(known)
    depth: dict[str, float] = {}

    def predict(contour: Contour, remarks: list[str]) -> Array:
        contour = contour_over_die(contour)  # depths of samples count from the top of the die
        # the floor of the plan lies where its last contour goes: count and step tell, as on the plan itself
        step = job_file.job.path.incremental_depth
        floor = depth.setdefault(
            contour.plan_id, float(contour.forming_tip[:, 2].min()) - step * (contour.count - 1 - contour.index)
        )
        row = features(contour, floor)
        inside = np.clip(row, low, high)
        far = np.abs(row - inside) > 0.05 * np.maximum(high - low, 1e-9)
        for k in np.flatnonzero(far.any(axis=0)):
            remarks.append(f"{FEATURES[k]} is outside the learned range: the value at its edge is used")
        return np.clip(model.predict(inside), max(smallest, -LARGEST_CORRECTION), min(largest, LARGEST_CORRECTION))

    return LearnedEstimator("learned_map", job_file, predict)


def knowledge(job_file: JobFile) -> Learned:
    """The file named in the job; raises IsfError LEARNING_UNUSABLE."""
    name = job_file.job.springback.learning
    if name is None:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            "the job names no file",
            where="springback.learning",
            advice="make one with: isf learn RUN... -o FILE",
        )
    return learning.load(job_file.base / name)


def fit_map(known: Learned) -> tuple[Any, Array, Array, float, float]:
    """Fitted model of springback (m) over the features, range of the features (4,), (4,) and of springback, m.

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
    return model, low, high, float(smallest), float(largest)
