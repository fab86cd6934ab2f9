"""How the contours so far were pushed, and what their wall tells of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from isf_core.height_map import HeightMap
from numpy.typing import NDArray

from isf_springback.loop_path import nearest_points
from isf_springback.scan_processing import FormedShape
from isf_springback.shape_reading import read_errors

Array = NDArray[np.float64]

DEEPER = 0.2e-3
"""m of more push than on the contour before, beyond which a contour wipes out the traces of that one."""
MADE_BY = 4
"""Contours that make the wall at one place: the ball touches it again and again."""
EVERY = 4
"""Contours between those whose wall is looked at again."""
REMEMBERED = 40
"""Contours that are remembered (assumed: those within a tool's width of most walls)."""
OLD_DEVIATION = 0.3e-3
"""m, of an error read on older wall, twice that beside the contour (assumed): the bias has moved on since."""
BESIDE = 30e-3
"""m in plan view from a place within which older wall speaks for it (assumed: as far as bias is alike)."""


@dataclass(frozen=True)
class FormedStep:
    """One contour of N points: how it was pushed, and what the model says of it, with the force measured on it once
    that is known; (N,) m each."""

    contour: Contour
    pushed: Array
    model: Array

    def same_wall(self, contour: Contour) -> bool:
        """True when both contours belong to one feature, stage and forming tool of one plan."""
        known = self.contour
        return (known.plan_id, known.feature, known.stage, known.forming_tool) == (
            contour.plan_id,
            contour.feature,
            contour.stage,
            contour.forming_tool,
        )


def expected_error(steps: Sequence[FormedStep], place: Array) -> Array:
    """(M,) m, error of the wall at ``place`` (M, 2) m by the model alone: mean over the contours that made it.

    These are the last :data:`MADE_BY` of ``steps``; one that went deeper than the one before it by more than
    :data:`DEEPER` is the first that counts.
    """
    total, count, counts = np.zeros(len(place)), np.zeros(len(place)), np.ones(len(place))
    later: Array | None = None
    for step in reversed(steps[-MADE_BY:]):
        near = nearest_points(place, step.contour.forming_tip[:, :2])
        pushed, model = step.pushed[near], step.model[near]
        if later is not None:
            counts = np.where(later > pushed + DEEPER, 0.0, counts)
        total += counts * (model - pushed)
        count += counts
        later = pushed
    return np.asarray(total / count)


def with_older_wall(
    steps: Sequence[FormedStep],
    shape: FormedShape,
    target: HeightMap,
    radius: float,
    place: Array,
    surprise: Array,
    deviation: Array,
) -> tuple[Array, Array]:
    """``surprise`` (M,) m at ``place`` (M, 2) m and its standard deviation (M,) m, with what older wall tells where the
    scan does not show the present one (NaN).

    The tool stands on the sheet while it is scanned, at the end of its contour, and hides what lies behind it: where
    all contours begin in one place, the same stretch of every one. Some contours on, the tool has moved inwards, and
    the older wall of that stretch comes out of its shadow. It is final, and tells the same of the model.

    ``steps`` are the contours so far, the last one is the present one; ``radius`` m of the tool.
    """
    surprise, deviation = surprise.copy(), deviation.copy()
    for back in range(EVERY, len(steps) - MADE_BY, EVERY):
        unseen = ~np.isfinite(surprise)
        if not unseen.any():
            break
        known = steps[: len(steps) - back]
        reading = read_errors(known[-1].contour, shape, target, radius)
        told = reading.wall - expected_error(known, reading.place)
        near = nearest_points(place, reading.place)
        beside = np.linalg.norm(reading.place[near] - place, axis=1) <= BESIDE
        taken = unseen & beside & np.isfinite(told[near])
        surprise[taken] = told[near][taken]
        deviation[taken] = OLD_DEVIATION
    return surprise, deviation
