"""The body of a tool above its tip: shank and holder as cylinders and cones about its axis, and how near they come.

Frame ``sheet``, m. Distances are exact to points; what a surface does between its points is not seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isf_core.files.tooling import ToolSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Indices

ASSUMED_STICK_OUT = 70e-3
"""m, from the tip to the chuck where a job does not say it (the middle one of the published tools: 43, 70, 100 mm)."""
ASSUMED_HOLDER = (60e-3, 25e-3)
"""m, length and radius of the cylinder that holds the tool where a job does not say it (assumed)."""


@dataclass(frozen=True)
class ToolSolid:
    """Parts (K, 4) m: begin and end along the axis, from the ball's centre, and the radii there; their ``names``.

    ``ball``: radius m of the tip.
    """

    parts: Array
    names: tuple[str, ...]
    ball: float

    @property
    def length(self) -> float:
        """m, from the ball's centre to the end of the last part."""
        return float(self.parts[-1, 1])

    def centre(self, tip: Array) -> Array:
        """(..., 3) m, of the ball of an upper tool with its lowest point at ``tip`` (..., 3)."""
        return np.asarray(tip + np.array([0.0, 0.0, self.ball]))

    def distance(self, points: Array, centre: Array, axis: Array) -> tuple[Array, Indices]:
        """(N,) m to the nearest part, negative inside, and (N,) which one, of ``points`` (N, 3) from a tool with its
        ball's ``centre`` (3,) and ``axis`` (3,)."""
        apart = points - centre
        along = apart @ axis
        beside = np.sqrt(np.maximum((apart * apart).sum(axis=1) - along**2, 0.0))
        each = np.stack([_to_frustum(along, beside, *part) for part in self.parts.tolist()])
        return each.min(axis=0), each.argmin(axis=0).astype(np.int64)

    def nearest(
        self, surface: HeightMap, more: Array, tip: Array, axis: Array, level: float = -np.inf
    ) -> tuple[float, Array, int]:
        """Distance m (negative: they cut into each other), place (3,) m and part that is nearest.

        Parameters
        ----------
        surface : sheet, which is no lower than ``level`` m ; more : (M, 3) m, other points of what is in the way
        """
        centre = self.centre(tip)
        ends = centre + self.parts[:, :2].reshape(-1, 1) * axis
        radius = self.parts[:, 2:].max()
        low, high = ends[:, :2].min(axis=0) - radius, ends[:, :2].max(axis=0) + radius
        columns = slice(*np.searchsorted(surface.x, [low[0], high[0]]))
        rows = slice(*np.searchsorted(surface.y, [low[1], high[1]]))
        gx, gy = np.meshgrid(surface.x[columns], surface.y[rows])
        heights = np.maximum(surface.z[rows, columns], level).ravel()
        near = ((more[:, :2] >= low) & (more[:, :2] <= high)).all(axis=1)
        points = np.vstack([np.column_stack([gx.ravel(), gy.ravel(), heights]), more[near]])
        points = points[np.isfinite(points[:, 2])]
        if not len(points):
            return float("inf"), np.full(3, np.nan), 0
        distance, part = self.distance(points, centre, axis)
        worst = int(np.argmin(distance))
        return float(distance[worst]), points[worst], int(part[worst])


def tool_solid(tool: ToolSpec) -> ToolSolid:
    """Shank and holder of ``tool``; what the job does not say is assumed (:data:`ASSUMED_STICK_OUT`, ...)."""
    shank = tool.radius if tool.shank_radius is None else tool.shank_radius
    chuck = (ASSUMED_STICK_OUT if tool.stick_out is None else tool.stick_out) - tool.ball_radius
    parts, names = [[0.0, chuck, shank, shank]], ["shank"]
    held = [(part.length, part.radius, part.top_radius) for part in tool.holder] or [(*ASSUMED_HOLDER, None)]
    for number, (length, radius, top) in enumerate(held, start=1):
        begin = parts[-1][1]
        parts.append([begin, begin + length, radius, radius if top is None else top])
        names.append(f"part {number} of the holder" if len(held) > 1 else "holder")
    return ToolSolid(np.array(parts), tuple(names), tool.ball_radius)


def _to_frustum(along: Array, beside: Array, begin: float, end: float, low: float, high: float) -> Array:
    """(N,) m, signed distance to a cone frustum in its half plane (distance along, distance beside its axis)."""
    slope = (high - low) / (end - begin)
    inside = (along >= begin) & (along <= end) & (beside <= low + slope * (along - begin))
    size = (end - begin) ** 2 + (high - low) ** 2
    share = np.clip(((along - begin) * (end - begin) + (beside - low) * (high - low)) / size, 0.0, 1.0)
    side = np.hypot(along - begin - share * (end - begin), beside - low - share * (high - low))
    bottom = np.hypot(along - begin, np.maximum(beside - low, 0.0))
    top = np.hypot(along - end, np.maximum(beside - high, 0.0))
    outer = np.minimum(side, np.minimum(bottom, top))
    return np.where(inside, -outer, outer)
