"""Forecast of the axial force of the coming contour from the forces of the last two.

Each law is a = 1 + c, b = -c in  F_i = a F_(i-1) + b F_(i-2):

* ``hold``: c = 0.
* ``half_step``: c = 1/2, the published law 1.5 F_(i-1) - 0.5 F_(i-2) (Ren 2018 eq. 4-14). A force that rises by d
  per contour is under-predicted by d/2, and with it the springback.
* ``linear``: c = 1, no lag on a ramp (default). It doubles the noise variance of the published law (5 against
  2.5 times one reading), which is harmless because sector means of a 1 % load cell are good to about 0.1 %.

Where the plan predicts forces, what is carried on is the measured share of them (:func:`forecast_along`): a wall that
becomes steeper on its way in raises the force, which the plan knows before it is measured.

The trend c (F_(i-1) - F_(i-2)) is limited to a part of the last force: a knee of the force curve is then overrun
by a bounded amount.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from isf_core.types import Array

ForecastLaw = Literal["hold", "half_step", "linear"]

TREND: dict[ForecastLaw, float] = {"hold": 0.0, "half_step": 0.5, "linear": 1.0}
"""Share c of the last change that is carried on."""

TREND_LIMIT = 0.25
"""Largest change of one forecast over the last force (assumed: a force that grows faster is still ramping up,
where the limits of the correction act first)."""


def forecast(
    last: Array, before_last: Array | None, law: ForecastLaw = "linear", trend_limit: float = TREND_LIMIT
) -> Array:
    """(M,) N, forecast at M places from the measured forces (M,) N of the last two contours.

    With one contour of history the last force is held (Ren 2018, 4.3.1: second block). Never negative.
    """
    recent: Array = np.maximum(np.asarray(last, dtype=np.float64), 0.0)
    if before_last is None:
        return recent
    trend = TREND[law] * (recent - np.maximum(before_last, 0.0))
    bound = trend_limit * recent
    return np.asarray(np.maximum(recent + np.clip(trend, -bound, bound), 0.0))


def forecast_along(planned: Sequence[Array], last: Array, before_last: Array | None, law: ForecastLaw) -> Array:
    """As :func:`forecast`, of the measured force as a share of the planned one.

    ``planned``: (M,) N at the same places on the contours in hand and, last, on the coming one; (0,) where the plan
    tells none, and nothing is changed.
    """
    if len(planned) < (2 if before_last is None else 3) or not all(len(force) for force in planned):
        return forecast(last, before_last, law)
    coming = np.maximum(planned[-1], 1.0)
    older = None if before_last is None else before_last * coming / np.maximum(planned[-3], 1.0)
    return forecast(last * coming / np.maximum(planned[-2], 1.0), older, law)
