"""The model's prediction freed of what one contour's force does to the next, for methods that also see the shape.

A push that grows makes a deeper step, the deeper step a larger force, and the larger force a larger prediction: with
``m = k F`` and ``F = F_0 + K (c - c_before)`` the correction follows ``c_next = s + a (c - 2 c_before + c_2before)``,
``a = k K``, once a scan has shown the springback s. From a = 0.5 on this swings for ever; with the shell model k is 4
to 5 um/N (Ren 2018, Table 4.6), K some 200 to 300 N/mm, a about 1 to 1.4. Steps add nothing to the force over several
contours, so that a mean over several contours is free of the swing: a becomes about :data:`SHARE` times as large.
While the force still rises into its plateau, nothing is averaged: there the prediction must not lag.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour
from numpy.typing import NDArray

from isf_springback.loop_path import nearest_points

Array = NDArray[np.float64]

SHARE = 0.25
"""Part of a change of the prediction that is followed per contour, over about four (assumed; a of 1.4 becomes 0.35)."""

PLATEAU = 0.15e-3
"""m per contour; a prediction that rises less has come to its plateau (the drift of the bias, see bias_field)."""


class SteadyPrediction:
    """State: the predictions of the last two contours, and the contour at which the plateau was reached."""

    def __init__(self) -> None:
        self._steps: list[tuple[Contour, Array, float]] = []
        self._plateau = -1

    def clear(self) -> None:
        """A new part begins."""
        self._steps, self._plateau = [], -1

    def scaled(self, factors: list[Array]) -> None:
        """The model changed: multiply the predictions of the contours of :attr:`steps` by ``factors``."""
        self._steps = [
            (contour, factor * value, float(np.mean(factor)) * raw)
            for (contour, value, raw), factor in zip(self._steps, factors, strict=True)
        ]

    @property
    def steps(self) -> list[tuple[Contour, Array]]:
        """Contours, at most two and the newest last, and the prediction (N,) m used for each."""
        return [(contour, value) for contour, value, _ in self._steps]

    def take(self, contour: Contour, raw: Array, *, seen: bool) -> Array:
        """(N,) m, the prediction to use for ``contour`` where the model says ``raw`` (N,) m.

        ``seen``: scans tell what the model does not. Asking again for a contour starts from the same state.
        """
        before = [step for step in self._steps if _same_wall(step[0], contour) and step[0].index < contour.index]
        mean, value = float(np.mean(raw)), np.asarray(raw)
        if not before or before[-1][0].index != contour.index - 1:
            self._plateau = -1
        else:
            last, used, raw_before = before[-1]
            if self._plateau < 0 or self._plateau >= contour.index:
                rising = mean - raw_before > PLATEAU
                self._plateau = contour.index if seen and not rising and raw_before > PLATEAU else -1
            if self._plateau >= 0:
                used = used[nearest_points(contour.forming_tip[:, :2], last.forming_tip[:, :2])]
                value = used + SHARE * (value - used)
        self._steps = [*before[-1:], (contour, value, mean)]
        return value


def _same_wall(contour: Contour, other: Contour) -> bool:
    """True when both contours belong to one feature, stage and forming tool of one plan."""
    return (contour.plan_id, contour.feature, contour.stage, contour.forming_tool) == (
        other.plan_id,
        other.feature,
        other.stage,
        other.forming_tool,
    )
