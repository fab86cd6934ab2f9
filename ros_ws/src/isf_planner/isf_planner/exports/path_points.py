"""A plan as one table of points for machine programs: both tips, speed and command force at every point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class PathPoints:
    """N points of a program; a closed contour ends with its first point once more.

    Attributes
    ----------
    contour : (N,) number of the contour
    tool_1, tool_2 : (N, 3) m, tips of the upper and the lower tool; NaN of a tool that is not there
    speed : (N,) m/s ; force : (N,) N, set-point of the support tool's normal force, 0 for position control
    lift : (N,) bool, both tools are lifted clear before this point
    """

    contour: Indices
    tool_1: Array
    tool_2: Array
    speed: Array
    force: Array
    lift: NDArray[np.bool_]

    @property
    def two_tools(self) -> bool:
        """True when both tools move."""
        return bool(np.isfinite(self.tool_1).all() and np.isfinite(self.tool_2).all())


def path_points(contours: Sequence[Contour]) -> PathPoints:
    """Points of all contours in their order."""
    parts: dict[str, list[Array]] = {"contour": [], "tool_1": [], "tool_2": [], "speed": [], "force": [], "lift": []}
    for contour in contours:
        n = len(contour)
        order = np.append(np.arange(n), 0) if contour.closed else np.arange(n)
        missing = np.full((n, 3), np.nan)
        support = contour.support_tip if contour.has_support else missing
        tips = (contour.forming_tip, support) if contour.forming_tool == 1 else (support, contour.forming_tip)
        speed = contour.speed if len(contour.speed) else np.full(n, contour.feed)
        force = contour.support_force if contour.force_controlled else np.zeros(n)
        lift = np.zeros(len(order), dtype=bool)
        lift[0] = contour.retract or not parts["lift"]
        parts["contour"].append(np.full(len(order), contour.index))
        for name, value in zip(("tool_1", "tool_2", "speed", "force"), (*tips, speed, force), strict=True):
            parts[name].append(value[order])
        parts["lift"].append(lift)
    return PathPoints(**{name: np.concatenate(value) for name, value in parts.items()})  # type: ignore[arg-type]


def without_closing(points: PathPoints) -> list[tuple[Array, Array]]:
    """Tips (tool_1, tool_2) of every contour, each (n, 3) m, without the repeated first point."""
    result = []
    for number in dict.fromkeys(points.contour.tolist()):
        mine = points.contour == number
        first, second = points.tool_1[mine], points.tool_2[mine]
        known = first if np.isfinite(first).all() else second
        last = len(known) - 1 if len(known) > 3 and np.array_equal(known[0], known[-1]) else len(known)
        result.append((first[:last], second[:last]))
    return result
