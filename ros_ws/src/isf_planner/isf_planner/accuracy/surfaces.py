"""Accuracy surfaces: the deviation of a part that was never formed, from those of parts that were.

The published model is MARS, a sum of products of hinge functions (Behera 2015, introduction). Here it is a sum of
regression trees (gradient boosting, scikit-learn's HistGradientBoostingRegressor), which has the smallest error on
parts held out of learning among those compared (docs/methods/accuracy_surfaces.md): as MARS it cuts the predictors at
knots of its own choice, and takes their products where they help.

Outside of the range of what was learned the expected deviation fades to zero, and with it the correction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array, Mask

from isf_planner.accuracy.formed_parts import FormedPart, FormedParts
from isf_planner.accuracy.places import KINDS, NUMBERS, Places

FEWEST_SHAPES = 4
"""Different parts from which something is learned: each must be held out in turn and leave a few (assumed)."""

BOOSTING: dict[str, Any] = {
    "max_iter": 120,
    "learning_rate": 0.08,
    "max_leaf_nodes": 8,
    "min_samples_leaf": 60,
    "early_stopping": False,  # its random split holds places of the same parts out, which says nothing
    "random_state": 0,
}
"""Small trees, so that a single part cannot have leaves of its own (assumed)."""

MM = 1e3
"""Deviations are fitted in mm: the library takes a gain below 1e-7 for none."""

SHRINKAGE = 1.0
"""Weight, in parts, that pulls the value of a leaf to zero (assumed)."""

FADING = 0.25
"""Over this share of its range beyond it, a predictor takes the correction back to zero (assumed)."""

SAME = 0.02
"""Of its size: what a predictor that was the same in all parts may differ by (assumed)."""


@dataclass(frozen=True)
class Expected:
    """Expected deviation of N places.

    Attributes
    ----------
    deviation : (N,) m, along the normal, positive too shallow
    trust : (N,) 1 inside the range of what was learned, down to 0 outside
    remarks : what lies outside, for people
    """

    deviation: Array
    trust: Array
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class AccuracySurfaces:
    """A fitted model.

    Attributes
    ----------
    model : of deviation, mm
    low, high : (P,) range of the predictors ; kinds : (K,) which kinds of feature were learned
    """

    model: Any
    low: Array
    high: Array
    kinds: Mask

    def expect(self, places: Places) -> Expected:
        """Deviation to be expected at ``places``."""
        formed = places.formed.ravel()
        trust, remarks = self._trust(places.values, formed)
        return Expected(np.where(formed, self.predict(places.values), 0.0), trust * formed, remarks)

    def predict(self, values: Array) -> Array:
        """(N,) m at ``values`` (N, P), never more than the largest that was learned."""
        return np.asarray(self.model.predict(values) / MM)

    def _trust(self, values: Array, formed: Mask) -> tuple[Array, tuple[str, ...]]:
        trust, remarks = np.ones(len(values)), []
        for k, name in enumerate(NUMBERS):
            low, high = self.low[k], self.high[k]
            width = FADING * (high - low) if high > low else SAME * max(abs(low), 1e-9)
            beyond = np.maximum(low - values[:, k], values[:, k] - high) / width
            left = 1.0 - np.clip(beyond, 0.0, 1.0)
            left = left * left * (3.0 - 2.0 * left)
            if (share := float((left < 0.5)[formed].mean())) > 0.01:
                remarks.append(f"{name}: {share:.0%} of the part outside of what was learned ({low:.3g} to {high:.3g})")
            trust = trust * left
        for known, kind, here in zip(self.kinds, KINDS, values[:, len(NUMBERS) :].T > 0.5, strict=True):
            if not known and here.any():
                trust = np.where(here, 0.0, trust)
                remarks.append(f"{kind.title}: {float(here[formed].mean()):.0%} of the part, and none was learned")
        return trust, tuple(remarks)


def fit(parts: Sequence[FormedPart]) -> AccuracySurfaces:
    """The model of ``parts``, every shape of the same weight."""
    # late: half a second that plans without accuracy surfaces need not pay
    from sklearn.ensemble import HistGradientBoostingRegressor

    values, deviation, weight = samples(parts)
    model = HistGradientBoostingRegressor(**BOOSTING, l2_regularization=SHRINKAGE)
    model.fit(values, MM * deviation, sample_weight=weight)
    return AccuracySurfaces(model, values.min(axis=0), values.max(axis=0), values[:, len(NUMBERS) :].any(axis=0))


def with_held_out(formed: FormedParts) -> FormedParts:
    """The same parts, each with what is left of its deviation when it is predicted from the other shapes.

    Raises
    ------
    IsfError : LEARNING_UNUSABLE, too few different parts
    """
    shapes = formed.shapes
    if len(shapes) < FEWEST_SHAPES:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            f"{len(shapes)} different part(s), {FEWEST_SHAPES} are needed: each is predicted from the others in turn",
            where=", ".join(dict.fromkeys(part.name for part in formed.parts)),
            advice="learn from runs of more parts of different shape",
        )
    left = {}
    for shape in shapes:
        model = fit([part for part in formed.parts if part.shape != shape])
        for k, part in enumerate(formed.parts):
            if part.shape == shape:
                left[k] = part.rms(part.deviation - model.predict(part.values))
    return replace(formed, parts=tuple(replace(part, left=left[k]) for k, part in enumerate(formed.parts)))


def samples(parts: Sequence[FormedPart]) -> tuple[Array, Array, Array]:
    """Values (S, P), deviation (S,) m and weight (S,) of ``parts``; every shape weighs 1."""
    shapes = [part.shape for part in parts]
    weight = np.concatenate([part.weight / shapes.count(part.shape) for part in parts])
    return np.vstack([part.values for part in parts]), np.concatenate([part.deviation for part in parts]), weight
