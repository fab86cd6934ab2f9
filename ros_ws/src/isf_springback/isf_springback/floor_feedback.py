"""Passes over the floor (planner, ``path.floor_step``) corrected from scans: pressed to level from above, step by step.

A pass over the floor needs less force than the contour on the wall before it, by a share that nobody knows before; a
floor pressed too deep cannot be raised. So the contour that reaches the floor is pressed no more than the wall, the
first pass less, and every further one as deep as the nearest pass before it, plus what is left there: more where the
floor still stands up, less where it lies too deep. On a further round it is pressed by a part of what is left only.
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour, makes_floor, over_floor
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from scipy.ndimage import distance_transform_edt, median_filter

from isf_springback.loop_path import nearest_points
from isf_springback.scan_processing.sections import heights_at

FIRST_SHARE = 0.6
"""Push of the first pass over the push on the wall before it (assumed, on the careful side)."""
NEXT_ROUND = 0.5
"""Share of what is left that a further pass over the same ring presses deeper (assumed): the rings beside it lower it
too, and scans scatter. With all of it the base of lu_cone came out up to 0.17 mm off in worlds 2 and 3, 0.16 and
0.14 mm with half."""
SAME_PLACE = 0.2e-3
"""m between points of passes that follow the same ring."""
WIDTH = 5
"""mm, places over which an error is read (median)."""


def at_edge(contour: Contour, job_file: JobFile, wanted: Array, pushed: Array) -> Array:
    """(N,) m, push on ``contour`` of ``wanted`` (N,) m: where it reaches a floor that is passed over, no more than
    ``pushed`` (N,) m on the contour before."""
    if job_file.job.path.floor_step is None or not makes_floor(contour):
        return wanted
    return np.minimum(wanted, np.maximum(pushed, 0.0))


class FloorFeedback:
    """Pushes on the floor of one feature, and the error of the floor by the newest scan."""

    def __init__(self) -> None:
        self._place = np.empty((0, 2))
        self._push = np.empty(0)
        self._pending: tuple[Contour, Array] | None = None
        self._error: HeightMap | None = None

    def passes(self, contour: Contour) -> bool:
        """True when ``contour`` was the last pass over this floor."""
        known = self._pending
        return known is not None and (known[0].plan_id, known[0].index) == (contour.plan_id, contour.index)

    def update(self, surface: HeightMap, target: HeightMap) -> None:
        """The shape after the last contour."""
        places = np.stack(np.meshgrid(target.x, target.y), axis=-1)
        error = heights_at(surface, places) - target.z
        unknown = ~np.isfinite(error)
        if not unknown.all():  # in holes of the scan: as beside them
            row, column = distance_transform_edt(unknown, return_distances=False, return_indices=True)
            self._error = HeightMap(target.x, target.y, median_filter(error[row, column], WIDTH))

    def push(self, contour: Contour, before: Contour | None, pushed: Array) -> Array | None:
        """(N,) m, push wanted on ``contour``; None when it is no pass over the floor.

        ``pushed`` (N,) m, push of the contour ``before`` it, seen from ``contour``.
        """
        if before is None or not over_floor(contour, before):
            return None
        if self.passes(before):
            self._settle()
        elif not self.passes(contour):  # asked again, the passes before it are those known
            self._place, self._push = np.empty((0, 2)), np.empty(0)
        if not len(self._place):
            return FIRST_SHARE * np.maximum(pushed, 0.0)
        near = nearest_points(contour.forming_tip[:, :2], self._place)
        left = np.zeros(len(contour)) if self._error is None else heights_at(self._error, self._place[near])
        again = np.linalg.norm(self._place[near] - contour.forming_tip[:, :2], axis=1) <= SAME_PLACE
        left = np.where(again & (left > 0.0), NEXT_ROUND * left, left)
        return np.maximum(self._push[near] + left, 0.0)

    def add(self, contour: Contour, push: Array) -> None:
        """The pass ``contour`` is formed with ``push`` (N,) m."""
        self._pending = contour, push

    def _settle(self) -> None:
        """The last pass replaces the passes before it at its place."""
        if self._pending is None:
            return
        contour, push = self._pending
        place = contour.forming_tip[:, :2]
        if len(self._place):
            apart = np.linalg.norm(place[nearest_points(self._place, place)] - self._place, axis=1)
            kept = apart > SAME_PLACE
            self._place, self._push = self._place[kept], self._push[kept]
        self._place, self._push = np.vstack([self._place, place]), np.concatenate([self._push, push])
