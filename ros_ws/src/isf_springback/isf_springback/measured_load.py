"""What one contour told of the force, carried to the next one by place."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isf_core.contour import Contour
from isf_core.types import Array

from isf_springback.loop_path import nearest_points


@dataclass(frozen=True)
class MeasuredLoad:
    """What one contour told, N points.

    Attributes
    ----------
    index : the contour
    place : (N, 2) m
    load : (N,) N, axial sheet load averaged over a sector of path
    steepest : (N,) rad, steepest wall met here on the way in from the opening
    planned : (N,) N, largest force that the plan predicted here on the way in, or (0,) when it tells none
    """

    index: int
    place: Array
    load: Array
    steepest: Array
    planned: Array = field(default_factory=lambda: np.empty(0))

    def load_at(self, points: Array) -> Array:
        """(M,) N, load at the nearest place in plan view of ``points`` (M, 2) m."""
        return np.asarray(self.load[nearest_points(points, self.place)])

    def steepest_at(self, points: Array) -> Array:
        """(M,) rad, steepest wall at the nearest place of ``points`` (M, 2) m."""
        return np.asarray(self.steepest[nearest_points(points, self.place)])

    def planned_at(self, points: Array) -> Array:
        """(M,) N, planned force at the nearest place of ``points`` (M, 2) m, or (0,)."""
        return np.asarray(self.planned[nearest_points(points, self.place)]) if len(self.planned) else self.planned


def steepest_wall(angle: Array, place: Array, before: list[MeasuredLoad]) -> Array:
    """(N,) rad, ``angle`` (N,) or the steepest wall at the nearest place of the contour before, if that is more."""
    return np.maximum(angle, before[0].steepest_at(place)) if before else np.array(angle)


def planned_force(contour: Contour, place: Array, before: list[MeasuredLoad]) -> Array:
    """(M,) N, predicted force at ``place`` (M, 2) m, or that of the contour before, if that is more; (0,): not told."""
    if not len(contour.predicted_force):
        return np.empty(0)
    force = np.asarray(contour.predicted_force[nearest_points(place, contour.forming_tip[:, :2])])
    known = before and len(before[0].planned)
    return np.maximum(force, before[0].planned_at(place)) if known else force
