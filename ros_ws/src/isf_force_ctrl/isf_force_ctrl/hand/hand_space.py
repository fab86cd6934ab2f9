"""Where a tool may go by hand: travel and axes of the rig, the sheet, the frame of the clamp, the other tool.

Frame ``sheet``, SI units. A tool that stands where it must not be may leave, but not go further in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.rig import Rig
from isf_core.geometry.capsules import segment_to_segment
from isf_core.geometry.tool_axis import UPRIGHT, point_on_axis, tilt_of
from isf_core.types import Array, Mask

PITCH = 1e-3
"""m between two points of a way that are looked at."""

SHANK = 0.2
"""m of a tool's axis that the other tool must not touch (chosen)."""

TOLERANCE = 1e-9
"""m by which a point counts as further in than the begin."""


@dataclass(frozen=True)
class HandSpace:
    """Room of both tools of one job.

    Attributes
    ----------
    rig : the machine
    radii : m, of the balls; None: the job has no such tool
    thickness : m, of the sheet, which lies between z = 0 and below
    depth : m, how far the sheet reaches below its plane; a lower tool stays below
    axis : (3,) unit, of tool 1 from its tip into its shank
    """

    rig: Rig
    radii: tuple[float, float | None]
    thickness: float
    depth: float = 0.0
    axis: tuple[float, float, float] = UPRIGHT

    @staticmethod
    def of_job(job_file: JobFile, depth: float = 0.0, axis: tuple[float, float, float] = UPRIGHT) -> HandSpace:
        """Room of the tools of a job, the sheet formed ``depth`` m deep."""
        job = job_file.job
        lower = None if job.tool_2 is None else job.tool_2.ball_radius
        return HandSpace(job_file.rig, (job.tool_1.ball_radius, lower), job.sheet.thickness, depth, axis)

    def floor(self, tool: int) -> float:
        """m, height of the side of the sheet that ``tool`` (1, 2) comes to."""
        return 0.0 if tool == 1 else -(self.thickness + self.depth)

    def check(self, tool: int, start: Array, end: Array, other: Array, *, to_sheet: bool) -> None:
        """Raise IsfError when the tip of ``tool`` (1, 2) cannot go straight from ``start`` to ``end`` (3,) m.

        ``other`` (3,) m: tip of the other tool. ``to_sheet``: it may touch the sheet (the force is watched).

        Raises IsfError MOVE_OUT_OF_REACH, MOVE_INTO_SHEET, MOVE_INTO_TOOL.
        """
        self.check_tool(tool)
        end = np.asarray(end, dtype=float)
        if end.shape != (3,) or not np.isfinite(end).all():
            raise IsfError(
                ErrorCode.MOVE_OUT_OF_REACH, "the position is no number", where=f"tool_{tool}", advice="give x, y, z"
            )
        points = _points(np.asarray(start, dtype=float), end)
        where = f"tool_{tool} to {place(end)}"
        travel = np.asarray(self.rig.limits.travel)
        if _further_in(np.maximum(np.abs(points) - travel, 0.0).max(axis=1)):
            text = " x ".join(f"{1e3 * value:.0f}" for value in travel)
            raise IsfError(
                ErrorCode.MOVE_OUT_OF_REACH,
                f"leaves the travel of the rig {self.rig.name} (+-{text} mm)",
                where=where,
                advice="choose a place within it",
            )
        if not (reached := self._reached(tool, points))[1:].all():
            first = points[1:][~reached[1:]][0]
            raise IsfError(
                ErrorCode.MOVE_OUT_OF_REACH,
                f"the axes of the rig {self.rig.name} do not reach {place(first)}",
                where=where,
                advice="go round, or tilt the tool less",
            )
        up = 1.0 if tool == 1 else -1.0
        in_sheet = np.maximum(up * (self.floor(tool) - points[:, 2]), 0.0)
        if not to_sheet and (in_sheet[-1] > TOLERANCE or _further_in(in_sheet)):
            side = "above" if tool == 1 else "below"
            raise IsfError(
                ErrorCode.MOVE_INTO_SHEET,
                f"would go into the sheet, which it comes to at z = {1e3 * self.floor(tool):g} mm",
                where=where,
                advice=f"stay {side} it, or touch it with jog, which stops at the force",
            )
        if _further_in(self._in_frame(tool, points)):
            raise IsfError(
                ErrorCode.MOVE_INTO_SHEET,
                f"would run into the frame of the clamp, {1e3 * self.rig.clamp.height:g} mm high",
                where=where,
                advice="lift the tool above the frame before it leaves the opening",
            )
        if _further_in(self._into_other(tool, points, np.asarray(other, dtype=float))):
            raise IsfError(
                ErrorCode.MOVE_INTO_TOOL,
                f"would run into tool_{3 - tool} at {place(other)}",
                where=where,
                advice=f"move tool_{3 - tool} away first",
            )

    def check_tool(self, tool: int) -> None:
        """Raise IsfError MOVE_OUT_OF_REACH for a ``tool`` that the job does not have."""
        if tool not in (1, 2) or self.radii[tool - 1] is None:
            raise IsfError(
                ErrorCode.MOVE_OUT_OF_REACH,
                f"the job has no tool {tool}",
                where="tool",
                advice="1 is the upper tool; 2, the lower one, only where the job names tool_2",
            )

    def room(self, tool: int, start: Array, direction: Array, other: Array) -> float:
        """m that the tip of ``tool`` can go from ``start`` (3,) m along the unit ``direction`` (3,); 0: nowhere."""
        start, direction = np.asarray(start, dtype=float), np.asarray(direction, dtype=float)

        def fits(length: float) -> bool:
            try:
                self.check(tool, start, start + length * direction, other, to_sheet=True)
            except IsfError:
                return False
            return True

        low, high = 0.0, 2.0 * float(np.linalg.norm(self.rig.limits.travel))
        while high - low > 1e-4:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fits(middle) else (low, middle)
        return low

    def _reached(self, tool: int, points: Array) -> Mask:
        kinematics = self.rig.make_kinematics()[tool - 1]
        if tool == 1 and self.axis != UPRIGHT:
            axis = np.array(self.axis)
            return kinematics.reachable(point_on_axis(points, axis, self.radii[0]), tilt_of(axis))
        return kinematics.reachable(points)

    def _in_frame(self, tool: int, points: Array) -> Array:
        """(N,) m by which the points are below the top of the frame, outside its opening."""
        clamp, radius = self.rig.clamp, self.radii[tool - 1] or 0.0
        over = (np.abs(points[:, :2]) + radius > 0.5 * np.asarray(clamp.size)).any(axis=1)
        height = points[:, 2] if tool == 1 else -points[:, 2] - self.thickness
        return np.asarray(np.where(over, np.maximum(clamp.height - height, 0.0), 0.0))

    def _into_other(self, tool: int, points: Array, other: Array) -> Array:
        """(N,) m by which the two tools, with the sheet between them, would be too near to each other."""
        upper, lower = self.radii
        if lower is None or not np.isfinite(other).all():
            return np.zeros(len(points))
        tips = (points, other) if tool == 1 else (other, points)
        axis, up = np.array(self.axis), np.array([0.0, 0.0, 1.0])
        first, second = tips[0] + upper * up, tips[1] - lower * up
        first, second = np.broadcast_arrays(first, second)
        apart = segment_to_segment(first, first + SHANK * axis, second, second - SHANK * up)
        return np.maximum(upper + lower + self.thickness - apart, 0.0)


def place(point: Array) -> str:
    """A place for people, mm."""
    return "(" + ", ".join(f"{1e3 * float(value):.2f}" for value in point) + ") mm"


def _points(start: Array, end: Array) -> Array:
    """(N, 3) m along the way, both ends among them."""
    count = max(2, 1 + math.ceil(float(np.linalg.norm(end - start)) / PITCH))
    return np.linspace(start, end, count)


def _further_in(depth: Array) -> bool:
    """True when a point of a way is further in than its begin."""
    return bool((depth > depth[0] + TOLERANCE).any())
