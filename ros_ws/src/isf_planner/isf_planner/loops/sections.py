"""The loops of a part at its levels, and the tree of pockets and islands the loops belong to.

Levels (:mod:`isf_planner.loops.level_spacing`) are the same for all pockets; each pocket ends with a loop at its own
full depth. A level counts for a pocket when it lies at least 5 % of the first step above the pocket's bottom. Nothing
gets lost silently: a loop that is too short to be formed is reported.

Features: the places below a level lie within the places below the level above it. So every pocket loop has exactly one
pocket loop above it, its parent, and pockets only ever split on the way down. A feature is a chain of loops from
where it appears to where it splits or ends; the features a pocket splits into are its children. Around an island the
tip must stay outside, and islands only ever grow and merge on the way down: where two merge, the one with the longer
loop goes on. An island is a child of the pocket it stands in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job
from isf_core.types import Array

from isf_planner.loops import tip_loops
from isf_planner.loops.tip_loops import TipLoop, tip_loop
from isf_planner.part.mesh_checks import place_text
from isf_planner.surface.target_surface import TargetSurface


@dataclass(frozen=True)
class Feature:
    """A chain of loops that follow each other downwards (of a lower tool: upwards).

    Attributes
    ----------
    number : index in ``LoopTree.features``; parents come before their children
    parent : number of the feature it grows out of or stands in, -1 at the top
    island : True for the loops around an island
    forming_tool : 1 (upper) or 2 (lower: the feature rises above the blank)
    loops : indices into ``LoopTree.loops``, from the flange away
    """

    number: int
    parent: int
    island: bool
    forming_tool: int
    loops: tuple[int, ...]


@dataclass(frozen=True)
class LoopTree:
    """All loops of a part, and the features they belong to.

    ``loops`` stand feature by feature in the plain order of forming: parents before children, out to in.
    """

    loops: tuple[TipLoop, ...]
    features: tuple[Feature, ...]

    def children(self, number: int) -> tuple[Feature, ...]:
        """Features that grow out of feature ``number`` or stand in it; -1 for those at the top."""
        return tuple(feature for feature in self.features if feature.parent == number)


@dataclass(frozen=True)
class RoughLoop:
    """A level line before it is settled.

    Attributes
    ----------
    level : m ; points : (K, 2) m ; island : goes around higher ground
    above : indices of the loops higher up that it continues (pocket: its one parent; island: all islands it has
        swallowed, the longest first)
    pocket : index of the loop of the pocket an island stands in, -1 for a pocket
    real : False for the border of what is formed at all, which is no contour
    """

    level: float
    points: Array
    island: bool
    above: tuple[int, ...] = ()
    pocket: int = -1
    real: bool = True

    @property
    def polygon(self) -> shapely.Polygon:
        """Everything inside the loop, m."""
        return shapely.Polygon(self.points)


def link(nodes: list[RoughLoop], loops: Sequence[RoughLoop], before: Sequence[int]) -> list[int]:
    """Append the loops of one level to ``nodes``, linked to the nodes ``before`` (indices); their indices."""
    previous = {k: nodes[k].polygon for k in before}
    added: list[int] = []
    for loop in sorted(loops, key=lambda loop: loop.island):  # a pocket before the islands that stand in it
        if loop.island:
            shape = loop.polygon
            inside = [k for k in before if nodes[k].island and within(nodes[k].points, shape)]
            above = tuple(sorted(inside, key=lambda k: -previous[k].length))
            around = [k for k in added if not nodes[k].island and within(loop.points, nodes[k].polygon)]
            pocket = min(around, key=lambda k: nodes[k].polygon.area, default=-1)
        else:
            around = [k for k in before if not nodes[k].island and within(loop.points, previous[k])]
            above, pocket = (min(around, key=lambda k: previous[k].area),) if around else (), -1
        added.append(len(nodes))
        nodes.append(replace(loop, above=above, pocket=pocket))
    return added


def chains(nodes: Sequence[RoughLoop]) -> tuple[list[list[int]], list[int]]:
    """Features as chains of indices of ``nodes``, parents before children, and the parent of each (-1: none)."""
    heirs = np.bincount([loop.above[0] for loop in nodes if loop.above], minlength=len(nodes))
    found: list[list[int]] = []
    parents: list[int] = []
    owner: list[int] = []
    for k, loop in enumerate(nodes):
        upper = owner[loop.above[0]] if loop.above else -1
        if loop.above and heirs[loop.above[0]] == 1:
            owner.append(upper)
            found[upper].append(k)
            continue
        owner.append(len(found))
        found.append([k])
        parents.append(owner[loop.pocket] if loop.pocket >= 0 else upper)
    return _depth_first([[k for k in chain if nodes[k].real] for chain in found], parents)


def _depth_first(found: list[list[int]], parents: list[int]) -> tuple[list[list[int]], list[int]]:
    """Order of forming; chains without a loop leave their place to their children."""
    order: list[int] = []
    waiting = [number for number, parent in enumerate(parents) if parent < 0][::-1]
    while waiting:
        number = waiting.pop()
        order.append(number)
        waiting += [child for child, parent in enumerate(parents) if parent == number][::-1]
    renamed: dict[int, int] = {-1: -1}
    kept: list[int] = []
    for number in order:
        if found[number]:
            renamed[number] = len(kept)
            kept.append(number)
        else:
            renamed[number] = renamed[parents[number]]
    return [found[k] for k in kept], [renamed[parents[k]] for k in kept]


def within(points: Array, shape: shapely.Polygon) -> bool:
    """Most of a few points of a loop are inside: single ones may lie on the border where loops touch."""
    some = points[:: max(1, len(points) // 7)]
    inside = shapely.contains_xy(shape, some[:, 0], some[:, 1])
    return bool(np.count_nonzero(inside) * 2 > len(some))


BOTTOM_SHARES = (0.0, 0.05, 0.1, 0.2, 0.4)
"""Parts of the last step by which the last level is raised when the bottom is a dome without a floor."""

NOISE = 0.09e-3
"""m, depth or height below which many narrow loops at once are noise of a surface, as of a scanned one (assumed)."""

NOISE_LOOPS = 4
"""So many loops narrower than the tool are noise where they lie in one pocket :data:`NOISE` above the deepest place
(assumed)."""

PROBED = (0.0, 0.25, 0.5, 0.75)
"""Of the way from a level down to a floor just below it: where noise is looked for, of which the level may cross
little."""

NOISE_STEP = 10e-6
"""m, by which the last level of a pocket with a noisy floor is raised until nothing of the noise is left in it."""


@dataclass(frozen=True)
class TipGrid:
    """Tip heights on a grid: x (nx,), y (ny,), height (ny, nx), m; ``depth`` of the deepest place, m."""

    x: Array
    y: Array
    height: Array
    depth: float


@dataclass
class _Tracing:
    """Loops found so far, the pockets that end, and what has to be told; ``radius`` m of the forming ball."""

    radius: float
    nodes: list[RoughLoop] = field(default_factory=list)
    ends: list[_End] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _End:
    """A pocket that goes no deeper than ``lowest`` (m), below the loop ``above``; ``around`` limits where.

    ``noisy``: level (m) that noise of its floor crosses, where that is known.
    """

    lowest: float
    above: int
    around: Array
    noisy: float | None = None


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
    state = _Tracing(job.tool_1.ball_radius)
    least = tip_loops.SMALLEST_STEP * abs(float(levels[0]))
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
            f"no contour of {tip_loops.FEWEST_POINTS} points fits into the part",
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
            start = loops[above].start if above >= 0 else tip_loops.first_start(rough.points)
            loop = tip_loop(surface, rough.points, rough.level, job, start)
            loops.append(replace(loop, feature=number, parent=above, island=rough.island))
        features.append(Feature(number, parents[number], nodes[chain[0]].island, 1, tuple(position[k] for k in chain)))
    return LoopTree(tuple(loops), tuple(features))


def _real_parent(nodes: list[RoughLoop], k: int) -> int:
    return nodes[k].above[0] if nodes[k].above and nodes[nodes[k].above[0]].real else -1


def _slice(grid: TipGrid, level: float) -> list[tuple[Array, bool]]:
    return tip_loops.loops_at(grid.x, grid.y, grid.height, level)


def _descend(state: _Tracing, grid: TipGrid, front: list[int], level: float, least: float) -> list[int]:
    """Loops of the next level: linked, pockets that end before it set aside; the new front."""
    found = _slice(grid, level)
    count = sum(not island for _, island in found)
    bottoms = {id(points): _lowest(grid, points, count) for points, island in found if not island}
    found = _without_noise(state, grid, found, bottoms, front, level)
    pockets = [points for points, island in found if not island]
    deep = [points for points in pockets if level - bottoms[id(points)] >= least * (1 - 1e-9)]
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
        state.ends.append(_End(bottoms[id(points)], above[0] if above else -1, points))
    going_on = {k for index in added for k in state.nodes[index].above} | {end.above for end in state.ends}
    state.ends += [_end(grid, state.nodes, k, front) for k in front if not state.nodes[k].island and k not in going_on]
    return added


def _without_noise(
    state: _Tracing,
    grid: TipGrid,
    found: list[tuple[Array, bool]],
    bottoms: Mapping[int, float],
    front: list[int],
    level: float,
) -> list[tuple[Array, bool]]:
    """Loops of a level without those that noise makes on a floor; a pocket of ``front`` that goes no deeper ends there.

    Only so many at once are noise: a shallow mark of a clean part stays. ``bottoms``: m, lowest tip in the pockets
    ``found``, by the identity of their points.
    """
    for k in front:
        if state.nodes[k].island:
            continue
        shape = state.nodes[k].polygon
        inside = [(points, island) for points, island in found if within(points, shape)]
        below = [bottoms[id(points)] for points, island in inside if not island]
        if not below:
            continue
        lowest = min(below)
        ends = level - lowest < NOISE
        for share in PROBED if ends else (0.0,):
            probed = level + share * (lowest - level)
            crossed = [one for one in _slice(grid, probed) if within(one[0], shape)] if share else inside
            if noise := _noise(grid, crossed, probed, state.radius):
                break
        else:
            continue
        if ends:
            state.ends.append(_End(lowest, k, state.nodes[k].points, noisy=probed))
            noise = [points for points, _ in inside]
        else:
            state.warnings.append(_of_noise(noise, level))
        found = [one for one in found if not any(one[0] is points for points in noise)]
    return found


def _noise(grid: TipGrid, loops: Sequence[tuple[Array, bool]], level: float, radius: float) -> list[Array]:
    """Those of the ``loops`` of one pocket at a ``level`` that noise makes, for a ball of ``radius`` m.

    Marks of a clean part that are as shallow are few; deeper ones lie in pockets of their own above their bottoms.
    """
    slight = _slight(grid, loops, level, radius) if len(loops) >= NOISE_LOOPS else []
    if len(slight) < NOISE_LOOPS or all(island for _, island in loops):
        return []
    lowest = min(_lowest(grid, points, 2) for points, island in loops if not island)
    basins = [shapely.Polygon(points) for points, island in _slice(grid, lowest + NOISE) if not island]
    shared = [[points for points in slight if within(points, basin)] for basin in basins]
    return [points for one in shared if len(one) >= NOISE_LOOPS for points in one]


def _slight(grid: TipGrid, loops: Sequence[tuple[Array, bool]], level: float, radius: float) -> list[Array]:
    """Those of the ``loops`` that are narrower than the tool and hardly deeper, or higher, than their ``level``."""
    narrow = [points for points, _ in loops if tip_loops.perimeter(points) < 2.0 * np.pi * radius]
    return [points for points in narrow if np.abs(_inside(grid, points) - level).max(initial=0.0) < NOISE]


def _of_noise(loops: Sequence[Array], level: float) -> str:
    largest = max(loops, key=tip_loops.perimeter)
    return (
        f"{len(loops)} loops at level {level * 1e3:.2f} mm, narrower than the tool and less than {NOISE * 1e3:.2f} mm "
        f"deep or high, are left out as noise of the surface, one of them at "
        f"{place_text(np.append(largest.mean(axis=0), level))}: smooth or remesh the part, as for a scanned one"
    )


def _end(grid: TipGrid, nodes: list[RoughLoop], k: int, front: list[int]) -> _End:
    pockets = sum(not nodes[other].island for other in front)
    return _End(_lowest(grid, nodes[k].points, pockets), k, nodes[k].points)


def _lowest(grid: TipGrid, points: Array, pockets: int) -> float:
    """m, lowest tip inside a loop; with one pocket that is the full depth."""
    row, column = np.unravel_index(int(np.argmin(grid.height)), grid.height.shape)
    shape = shapely.Polygon(points)
    if pockets == 1 or shapely.contains_xy(shape, grid.x[column], grid.y[row]):
        return -grid.depth
    return float(_inside(grid, points).min(initial=np.inf))


def _inside(grid: TipGrid, points: Array) -> Array:
    """(M,) m, heights of the tip inside a loop."""
    low, high = points.min(axis=0), points.max(axis=0)
    columns = slice(*np.searchsorted(grid.x, [low[0], high[0]]))
    rows = slice(*np.searchsorted(grid.y, [low[1], high[1]]))
    gx, gy = np.meshgrid(grid.x[columns], grid.y[rows])
    inside = shapely.contains_xy(shapely.Polygon(points), gx, gy)
    return np.asarray(grid.height[rows, columns][inside])


def _close(state: _Tracing, grid: TipGrid, end: _End, spacing: float) -> None:
    """Last loops of a pocket: at its full depth, or just above the bottom of a dome or the noise of a floor.

    No loop when none is long enough above the last level but one, which then is the lowest.
    """
    shortest = tip_loops.FEWEST_POINTS * spacing
    top = state.nodes[end.above].level if end.above >= 0 and state.nodes[end.above].real else 0.0
    around = shapely.Polygon(end.around)

    def at(level: float) -> tuple[list[tuple[Array, bool]], list[Array]]:
        """All loops of the pocket at a level, and the borders long enough to be formed."""
        inside = [
            (points, island)
            for points, island in _slice(grid, level)
            if within(points, around) or (not island and within(end.around, shapely.Polygon(points)))
        ]
        return inside, [p for p, island in inside if not island and tip_loops.perimeter(p) >= shortest]

    noise: list[Array] = []
    for share in BOTTOM_SHARES:
        level = end.lowest + share * (top - end.lowest) if end.noisy is None else end.noisy
        if not np.isfinite(level):
            break
        inside, pockets = at(level)
        if found := _noise(grid, inside, level, state.radius):
            noise, crossed = found, level
            while _slight(grid, inside, level, state.radius) and level + NOISE_STEP < min(top, crossed + 2 * NOISE):
                level += NOISE_STEP
                inside, pockets = at(level)
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
        state.warnings.append(
            f"{_of_noise(noise, crossed)}; {raised}" if noise else f"the bottom has no floor: {raised}"
        )
