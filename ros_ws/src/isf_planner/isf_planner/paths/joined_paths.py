"""Contours that join: a continuous spiral, or loops connected by ramps within the wall.

One feature's chain of loops becomes one line over the phase (turns travelled), which is settled on the tip surface as
a whole and only then cut into contours, one per turn: every contour begins at the very point where the one before
ends, in the same direction.

* Spiral: once around on the first loop, then down by one loop per turn, then once around on the last loop (Torrao
  2013, 7.1.2), so that the opening and the floor are complete.
* Ramps: once around every loop, with a ramp of ``ramp_length`` down to the next one; the seam moves on by as much.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

from isf_planner.loops import tip_loops
from isf_planner.loops.tip_loops import FLATTEST, GOUGE_TOLERANCE
from isf_planner.part.mesh_checks import place_text
from isf_planner.paths.loop_family import LoopFamily, family
from isf_planner.surface import target_surface, tip_surface
from isf_planner.surface.target_surface import TargetSurface


@dataclass(frozen=True)
class TipPath:
    """A line of the forming tool's tip, N points in frame ``sheet``.

    Attributes
    ----------
    points : (N, 3) m ; normal : (N, 3) unit, from the contact to the centre of the tip's rounding
    closed : the last point is followed by the first
    feature, forming_tool : as in :class:`isf_planner.loops.tip_loops.TipLoop`
    joins : begins where the path before ends, in the same direction
    wall_right : seen along the path the wall it forms is on the right (on the left after a change of direction)
    """

    points: Array
    normal: Array
    closed: bool = True
    feature: int = 0
    forming_tool: int = 1
    joins: bool = False
    wall_right: bool = True

    def outward(self) -> Array:
        """(N, 3) unit horizontal vectors from the tool to the wall."""
        if self.closed:
            tangent = np.roll(self.points, -1, axis=0) - np.roll(self.points, 1, axis=0)
        else:
            tangent = np.gradient(self.points, axis=0)
        right = np.column_stack([tangent[:, 1], -tangent[:, 0], np.zeros(len(tangent))])
        right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-12)
        return right if self.wall_right else -right

    def turned(self) -> TipPath:
        """The path the other way round, a closed one from the same first point."""
        index = np.arange(len(self.points))[::-1]
        if self.closed:
            index = np.roll(index, 1)
        return replace(self, points=self.points[index], normal=self.normal[index], wall_right=not self.wall_right)


def spiral(surface: TargetSurface, chain: Sequence[TipPath], radius: float, spacing: float) -> list[TipPath]:
    """Continuous spiral through a chain of closed loops; see :func:`joined`."""
    last = len(chain) - 1
    ends = np.arange(last + 3.0)
    return joined(surface, chain, ends, lambda phase: np.clip(phase - 1.0, 0.0, last), radius, spacing)


def ramps(
    surface: TargetSurface, chain: Sequence[TipPath], ramp_length: float, radius: float, spacing: float
) -> list[TipPath]:
    """Closed loops of a chain connected by ramps of ``ramp_length`` m; see :func:`joined`."""
    perimeters = family([path.points for path in chain], spacing).perimeter()
    shares = np.minimum(ramp_length / perimeters[1:], 0.5)
    ends = np.concatenate([[0.0, 1.0], 1.0 + np.cumsum(1.0 + shares)])

    def level(phase: Array) -> Array:
        w = np.zeros(len(phase))
        for begin, share in zip(ends[1:-1], shares, strict=True):
            w += np.clip((phase - begin) / share, 0.0, 1.0)
        return w

    return joined(surface, chain, ends, level, radius, spacing)


def joined(
    surface: TargetSurface,
    chain: Sequence[TipPath],
    ends: Array,
    level: Callable[[Array], Array],
    radius: float,
    spacing: float,
) -> list[TipPath]:
    """Joined paths along a chain of loops.

    Parameters
    ----------
    surface : on which the tip of a ball of ``radius`` m runs
    chain : nested closed loops of one feature, all in the same sense
    ends : (T + 1,) phases at which the line is cut, the first one 0
    level : function from phases (N,) to coordinates of the family (N,)
    spacing : m, of the points

    Raises
    ------
    IsfError : PATH_BROKEN where the tip would be more than 20 um off the tip surface
    """
    loops = family([path.points for path in chain], spacing / 2)
    first = chain[0]
    side = 1.0 if first.wall_right else -1.0
    turns = [_dense(begin, end, loops, spacing) for begin, end in itertools.pairwise(ends)]
    phase = np.concatenate([turns[0][:1], *[turn[1:] for turn in turns]])
    cuts = np.cumsum([0] + [len(turn) - 1 for turn in turns])
    line = _settled(surface, loops.at(level(phase), phase), side, radius, steps=4)[0]
    pieces = [_equal_chords(line[a : b + 1], spacing) for a, b in itertools.pairwise(cuts)]
    cuts = np.cumsum([0] + [len(piece) - 1 for piece in pieces])
    line = np.vstack([pieces[0][:1], *[piece[1:] for piece in pieces]])
    line, contact, height = _settled(surface, line, side, radius, steps=3)
    _check(line, height)
    width = target_surface.smoothing_width(surface.facet_width, radius)
    normal = _smooth(tip_surface.contact_normals(surface, line[:, :2], contact, radius), spacing, width)
    return [
        replace(first, points=line[a : b + 1], normal=normal[a : b + 1], closed=False, joins=bool(a))
        for a, b in itertools.pairwise(cuts)
    ]


def _dense(begin: float, end: float, loops: LoopFamily, spacing: float) -> Array:
    count = int(np.ceil((end - begin) * float(loops.perimeter().max()) / (spacing / 2)))
    return np.linspace(begin, end, max(count, 24) + 1)


def _settled(
    surface: TargetSurface, line: Array, side: float, radius: float, *, steps: int
) -> tuple[Array, Array, Array]:
    """Points moved across the line until the tip surface is at their height; contacts (N, 2), heights (N,).

    As :func:`isf_planner.loops.tip_loops.settle` for an open line of any height. ``side``: uphill is on the right (1)
    or on the left (-1).
    """
    points, z = line[:, :2].copy(), line[:, 2]
    tangent = np.gradient(points, axis=0)
    right = side * np.column_stack([tangent[:, 1], -tangent[:, 0]])
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-12)
    longest = 0.1 * radius
    height, contact = tip_surface.drop_tool(surface, points, radius)
    for _ in range(steps):
        arm = points - contact
        vertical = np.sqrt(np.maximum(radius**2 - (arm**2).sum(axis=1), (0.05 * radius) ** 2))
        slope = np.maximum(-(arm * right).sum(axis=1) / vertical, FLATTEST)
        step = np.clip((z + tip_loops.LIFT - height) / slope, -longest, longest)
        points += step[:, None] * right
        height, contact = tip_surface.drop_tool(surface, points, radius, near=contact + step[:, None] * right)
    return np.column_stack([points, z]), contact, height


def _equal_chords(line: Array, spacing: float) -> Array:
    """An open line (N, 3) with equal chords near ``spacing``; both ends stay."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = max(4, round(arc[-1] / spacing))
    distance = arc[-1] * np.arange(count + 1) / count
    for _ in range(4):
        points = np.column_stack([np.interp(distance, arc, column) for column in line.T])
        reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        distance = np.interp(reached[-1] * np.arange(count + 1) / count, reached, distance)
    return np.column_stack([np.interp(distance, arc, column) for column in line.T])


def _check(line: Array, height: Array) -> None:
    off = np.abs(height - line[:, 2])
    if off.max() > GOUGE_TOLERANCE:
        worst = int(np.argmax(off))
        raise IsfError(
            ErrorCode.PATH_BROKEN,
            f"the joined path is {off[worst] * 1e6:.0f} um off the surface",
            where=f"path at {place_text(line[worst])}",
            advice="use path.style contours with path.transition step, or reduce path.incremental_depth",
        )


def _smooth(normal: Array, spacing: float, width: float) -> Array:
    """Normals (N, 3) of an open line smoothed over ``width`` m by a local parabola, as those of closed loops are."""
    window = min(2 * round(width / spacing / 2) + 1, 2 * (len(normal) // 6) + 1)
    if window < 5:
        return normal
    from scipy.signal import savgol_filter  # late: 0.5 s that other paths need not pay

    smooth = savgol_filter(normal, window, 2, axis=0, mode="interp")
    return np.asarray(smooth / np.linalg.norm(smooth, axis=1, keepdims=True))
