"""A planned part: contours, target and what is to be known of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from isf_core.contour import Contour
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.tool_axis import inclination
from isf_core.types import Array
from numpy.typing import NDArray

from isf_planner.accuracy.moved_target import MovedTarget
from isf_planner.checks.shank_checks import ShankClearance
from isf_planner.forming.stages import Stage
from isf_planner.loops.sections import LoopTree
from isf_planner.paths.partial_paths import PartialPaths
from isf_planner.replanning import PlanBase


@dataclass(frozen=True)
class Plan:
    """What is to be formed, and how.

    Attributes
    ----------
    plan_id : the same for the same job and files, as :func:`isf_planner.processes.plan_id` says
    contours : in the order of forming
    target : upper target surface over the clamp on a 1 mm grid, 0 beside the part
    mesh : vertices (V, 3) m in frame ``sheet`` and faces (F, 3) of the placed part
    warnings : what to look at before forming
    stages : shapes that the stages end with, the part last; none of a part formed in one stage
    partial : partial paths of all stages, side by side; none where the job does not ask for them
    tree : loops of the forming tool's tip with normals, curvatures and features, or None for a plan from a file
    base : what :func:`isf_planner.planning.replan` needs for a change of tool, or None
    shank : where shank and holder of a tilted tool come nearest to anything; None with an upright one
    ball_radius : m, of the upper tool's tip; NaN where a plan file does not hold it
    moved : the target as the contours form it, where accuracy surfaces move it; ``target`` and ``mesh`` are the part
    preforms : surfaces that the stages before the part end with, on the grid of ``target``; none where there are none
    hold_after : contours, counted from 1, after which a part formed through the node graph waits for a person or a PLC
    origin : where the contours come from, and what is not in them, lines for the head of a program
    spindle : rad/s of the upper tool on each contour, positive clockwise seen from above; none where it does not turn
    """

    plan_id: str
    contours: tuple[Contour, ...]
    target: HeightMap
    mesh: tuple[Array, NDArray[np.int64]]
    warnings: tuple[str, ...]
    stages: tuple[Stage, ...] = field(default=(), repr=False, compare=False)
    partial: tuple[PartialPaths, ...] = field(default=(), repr=False, compare=False)
    tree: LoopTree | None = field(default=None, repr=False, compare=False)
    base: PlanBase | None = field(default=None, repr=False, compare=False)
    shank: ShankClearance | None = field(default=None, repr=False, compare=False)
    ball_radius: float = field(default=float("nan"), compare=False)
    moved: MovedTarget | None = field(default=None, repr=False, compare=False)
    preforms: tuple[HeightMap, ...] = field(default=(), repr=False, compare=False)
    hold_after: tuple[int, ...] = field(default=(), compare=False)
    origin: tuple[str, ...] = field(default=(), compare=False)
    spindle: tuple[float, ...] = field(default=(), compare=False)

    @property
    def smallest_thickness(self) -> float:
        """m, thinnest predicted sheet."""
        return min(float(contour.thickness.min()) for contour in self.contours)

    @property
    def largest_wall_angle(self) -> float:
        """rad, at the contacts of the forming tool."""
        return max(float(contour.wall_angle.max()) for contour in self.contours)

    @property
    def path_length(self) -> float:
        """m, of the forming tip along all contours, without the moves between them."""
        return sum(contour.length for contour in self.contours)

    @property
    def forming_time(self) -> float:
        """s, at the planned feed, slower where a tilted tool has to turn, without the moves between contours."""
        return sum(_time(contour) for contour in self.contours)

    @property
    def largest_tilt(self) -> float:
        """rad, of the forming tool; 0 where it is upright all along."""
        return max((float(inclination(c.forming_axis).max()) for c in self.contours if c.tilted), default=0.0)


def _time(contour: Contour) -> float:
    """s along the contour."""
    if not (contour.tilted and len(contour.speed)):
        return contour.length / contour.feed
    order = np.arange(len(contour) + (1 if contour.closed else 0)) % len(contour)
    way = np.linalg.norm(np.diff(contour.forming_tip[order], axis=0), axis=1)
    slow = 1.0 / contour.speed[order]
    return float((0.5 * way * (slow[1:] + slow[:-1])).sum())
