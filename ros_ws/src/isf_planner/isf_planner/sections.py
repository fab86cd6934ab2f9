"""The loops of a part at all its levels: pockets, islands in them, and the bottom of every pocket.

Levels are the same for all pockets; each pocket ends with a loop at its own full depth. A level counts for a pocket
when it lies at least 5 % of the incremental depth above the pocket's bottom. Nothing gets lost silently: a loop that
is too short to be formed is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from isf_core.job import Job
from numpy.typing import NDArray

from isf_planner import resampling, slicing
from isf_planner.feature_tree import Feature, LoopTree, RoughLoop, chains, link, within
from isf_planner.target_surface import TargetSurface
from isf_planner.tip_loops import TipLoop, tip_loop

Array = NDArray[np.float64]

BOTTOM_SHARES = (0.0, 0.05, 0.1, 0.2, 0.4)
"""Parts of the last step by which the last level is raised when the bottom is a dome without a floor."""


@dataclass(frozen=True)
class TipGrid:
    """Tip heights on a grid: x (nx,), y (ny,), height (ny, nx), m; ``depth`` of the deepest place, m."""

    x: Array
    y: Array
    height: Array
    depth: float


@dataclass
class _Tracing:
    """Loops found so far, the pockets that end, and what has to be told."""

    nodes: list[RoughLoop] = field(default_factory=list)
    ends: list[_End] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _End:
    """A pocket that goes no deeper than ``lowest`` (m), below the loop ``above``; ``around`` limits where."""

    lowest: float
    above: int
    around: Array


def trace(grid: TipGrid, levels: Array, job: Job) -> tuple[list[RoughLoop], list[str]]:
    """All loops, linked, and warnings.

    Parameters
    ----------
    grid : tip surface of the forming tool
    levels : (K,) m, falling, the last one at the full depth
    job : point spacing and incremental depth

    Raises
    ------
    IsfError : CONTOUR_LOST for a loop that is not closed, PART_TOO_SMALL_FOR_TOOL when there is no loop at all
    """
    state = _Tracing()
    least = slicing.SMALLEST_STEP * abs(float(levels[0]))
    border = [RoughLoop(-least, points, island, real=False) for points, island in _slice(grid, -least)]
    front = link(state.nodes, border, [])
    for level in levels[:-1]:
        front = _descend(state, grid, front, float(level), least)
    state.ends += [_end(grid, state.nodes, k, front) for k in front if not state.nodes[k].island]
    for end in state.ends:
        _close(state, grid, end, job.path.point_spacing)
    if not any(loop.real for loop in state.nodes):
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"no contour of {resampling.FEWEST_POINTS} points fits into the part",
            where=f"level {levels[-1] * 1e3:.3f} mm",
            advice="reduce path.point_spacing or path.incremental_depth",
        )
    return state.nodes, state.warnings


def settle_all(
    nodes: list[RoughLoop], surface: TargetSurface, job: Job, step: Callable[[int, int], None] | None = None
) -> LoopTree:
    """Tip loops of all real nodes (as from :func:`trace`) with their features; ``step`` is told k of n."""
    order, parents = chains(nodes)
    position = {k: place for place, k in enumerate(k for chain in order for k in chain)}
    loops: list[TipLoop] = []
    features: list[Feature] = []
    for number, chain in enumerate(order):
        for k in chain:
            if step is not None:
                step(len(loops), len(position))
            rough = nodes[k]
            parent = _real_parent(nodes, k)
            above = position.get(parent, -1)
            start = loops[above].start if above >= 0 else resampling.first_start(rough.points)
            loop = tip_loop(surface, rough.points, rough.level, job, start)
            loops.append(replace(loop, feature=number, parent=above, island=rough.island))
        features.append(Feature(number, parents[number], nodes[chain[0]].island, 1, tuple(position[k] for k in chain)))
    return LoopTree(tuple(loops), tuple(features))


def _real_parent(nodes: list[RoughLoop], k: int) -> int:
    return nodes[k].above[0] if nodes[k].above and nodes[nodes[k].above[0]].real else -1


def _slice(grid: TipGrid, level: float) -> list[tuple[Array, bool]]:
    return slicing.loops_at(grid.x, grid.y, grid.height, level)


def _descend(state: _Tracing, grid: TipGrid, front: list[int], level: float, least: float) -> list[int]:
    """Loops of the next level: linked, pockets that end before it set aside; the new front."""
    found = _slice(grid, level)
    pockets = [points for points, island in found if not island]
    deep = [points for points in pockets if level - _lowest(grid, points, len(pockets)) >= least * (1 - 1e-9)]
    shallow = [points for points in pockets if not any(points is other for other in deep)]
    loops = [RoughLoop(level, points, False) for points in deep]
    shapes = [loop.polygon for loop in loops]
    loops += [
        RoughLoop(level, points, True)
        for points, island in found
        if island and any(within(points, shape) for shape in shapes)
    ]
    added = link(state.nodes, loops, front)
    for points in shallow:
        above = [k for k in front if not state.nodes[k].island and within(points, state.nodes[k].polygon)]
        state.ends.append(_End(_lowest(grid, points, len(pockets)), above[0] if above else -1, points))
    going_on = {k for index in added for k in state.nodes[index].above} | {end.above for end in state.ends}
    state.ends += [_end(grid, state.nodes, k, front) for k in front if not state.nodes[k].island and k not in going_on]
    return added


def _end(grid: TipGrid, nodes: list[RoughLoop], k: int, front: list[int]) -> _End:
    pockets = sum(not nodes[other].island for other in front)
    return _End(_lowest(grid, nodes[k].points, pockets), k, nodes[k].points)


def _lowest(grid: TipGrid, points: Array, pockets: int) -> float:
    """m, lowest tip inside a loop; with one pocket that is the full depth."""
    row, column = np.unravel_index(int(np.argmin(grid.height)), grid.height.shape)
    shape = shapely.Polygon(points)
    if pockets == 1 or shapely.contains_xy(shape, grid.x[column], grid.y[row]):
        return -grid.depth
    low, high = points.min(axis=0), points.max(axis=0)
    columns = slice(*np.searchsorted(grid.x, [low[0], high[0]]))
    rows = slice(*np.searchsorted(grid.y, [low[1], high[1]]))
    gx, gy = np.meshgrid(grid.x[columns], grid.y[rows])
    inside = shapely.contains_xy(shape, gx, gy)
    return float(grid.height[rows, columns][inside].min(initial=np.inf))


def _close(state: _Tracing, grid: TipGrid, end: _End, spacing: float) -> None:
    """Last loops of a pocket: at its full depth, or just above the bottom of a dome.

    No loop when none is long enough above the last level but one, which then is the lowest.
    """
    shortest = resampling.FEWEST_POINTS * spacing
    top = state.nodes[end.above].level if end.above >= 0 and state.nodes[end.above].real else 0.0
    around = shapely.Polygon(end.around)
    for share in BOTTOM_SHARES:
        level = end.lowest + share * (top - end.lowest)
        if not np.isfinite(level):
            break
        inside = [
            (points, island)
            for points, island in _slice(grid, level)
            if within(points, around) or (not island and within(end.around, shapely.Polygon(points)))
        ]
        pockets = [p for p, island in inside if not island and resampling.perimeter(p) >= shortest]
        if not pockets:
            continue
        shapes = [shapely.Polygon(points) for points in pockets]
        loops = [RoughLoop(level, points, False) for points in pockets]
        for points, island in inside:
            if island and any(within(points, shape) for shape in shapes):
                loops.append(RoughLoop(level, points, True))
        before = [end.above] if end.above >= 0 else []
        before += [
            k for k, loop in enumerate(state.nodes) if loop.island and end.above >= 0 and loop.pocket == end.above
        ]
        link(state.nodes, loops, before)
        break
    else:
        level = top
    if level > end.lowest:
        raised = f"the last contour runs {(level - end.lowest) * 1e3:.3f} mm above the deepest point"
        state.warnings.append(f"the bottom has no floor: {raised}")
