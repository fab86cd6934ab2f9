"""Tool marks of a plan: how far they lie apart, how high the ridges between them are, and the step for a wanted one.

Spacing is the distance from a contact to the line of contacts of the pass that the contour deepens; on a plane wall it
is dz / sin(wall angle) (Lu 2016 eq. 40), on fillets and floors it needs no angle. The ridge between two passes follows
from that and from the distance of the ball's centres alike, as the levels of constant scallop height do
(:mod:`isf_planner.loops.level_spacing`): sqrt(spacing x distance of the centres) on a curved wall. What the sheet's
springback, its friction and a worn tool do to the marks is not in it; measured spacings were up to 4.1 % smaller (Lu
2016, 4.1.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, makes_floor
from isf_core.files.job import Job
from isf_core.process.tool_marks import ridge_height, spacing_of_ridge
from isf_core.types import Array
from scipy.spatial import KDTree

from isf_planner.predict.predictions import formed_after, near_of

SHARE = 0.95
"""Of the path along the walls, on which a wanted surface is kept: as levels of constant scallop height keep it."""

FORCE_EXPONENT = 0.18
"""Of the depth step in the axial force (Aerens et al. 2009: ridge height^0.09, and that goes with the square)."""

NEAR_LIMIT = 0.85
"""Share of the wall angle that the sheet bears above which finer steps are warned of (assumed: 60 of some 70 deg)."""

LEAST_STEP = 1e-6
"""m in depth, less than which is none."""

JOINS = 0.2
"""Share of a contour's usual step below which it joins the pass before it, as a spiral does at its ends."""


@dataclass(frozen=True)
class ToolMarks:
    """Marks of one contour, N points; NaN where no pass runs beside it.

    Attributes
    ----------
    step : (N,) m, in depth from the pass that it deepens, of the tip
    spacing : (N,) m, to the marks of that pass, along the wall
    ridge : (N,) m, height between them
    pitch : (N,) m, distance of plane marks with ridges of that height
    way : (N,) m of path that each point stands for
    floor : the contour lies on a floor
    """

    step: Array
    spacing: Array
    ridge: Array
    pitch: Array
    way: Array
    floor: bool


def tool_marks(contours: Sequence[Contour], job: Job) -> tuple[ToolMarks | None, ...]:
    """Marks of every contour; None for one that deepens none: the first of a feature, and all of ADSIF."""
    if job.process == "ADSIF":
        return (None,) * len(contours)
    return tuple(
        _marks(contours[before], contour, job) if before >= 0 else None
        for contour, before in zip(contours, formed_after(contours, near_of(job)), strict=True)
    )


@dataclass(frozen=True)
class Surface:
    """Marks on the walls that the last stage leaves.

    Attributes
    ----------
    spacing, ridge : m, largest ; contour, point : where the highest ridge is, contour from 0
    usual_spacing, usual_ridge : m, kept on :data:`SHARE` of the path along the walls
    step : m, in depth, usual on the walls
    per_step, pitch_per_step : spacing and pitch over depth step, kept on that share
    floor_spacing, floor_ridge : m, largest on floors; None where the tool does not pass over them
    """

    spacing: float
    ridge: float
    contour: int
    point: int
    usual_spacing: float
    usual_ridge: float
    step: float
    per_step: float
    pitch_per_step: float
    floor_spacing: float | None
    floor_ridge: float | None


def surface_of(contours: Sequence[Contour], marks: Sequence[ToolMarks | None]) -> Surface | None:
    """What the last stage of ``contours`` with their ``marks`` leaves; None where nothing is known of its walls."""
    last = contours[-1].stage
    kept = [(k, one) for k, one in enumerate(marks) if one is not None and contours[k].stage == last]
    walls = [(k, one) for k, one in kept if not one.floor and (one.step > LEAST_STEP).any()]
    if not walls:
        return None
    highest = [float(np.nanmax(one.ridge)) for _, one in walls]
    worst, mark = walls[int(np.argmax(highest))]
    way = np.concatenate([one.way for _, one in walls])

    def kept_on_most(values: Sequence[Array]) -> float:
        return _quantile(np.concatenate(values), way)

    floors = [one for _, one in kept if one.floor]
    step = [np.where(one.step > max(JOINS * np.nanmedian(one.step), LEAST_STEP), one.step, np.nan) for _, one in walls]
    return Surface(
        spacing=max(float(np.nanmax(one.spacing)) for _, one in walls),
        ridge=max(highest),
        contour=worst,
        point=int(np.nanargmax(mark.ridge)),
        usual_spacing=kept_on_most([one.spacing for _, one in walls]),
        usual_ridge=kept_on_most([one.ridge for _, one in walls]),
        step=float(np.nanmedian(np.concatenate(step))),
        per_step=kept_on_most([one.spacing / down for (_, one), down in zip(walls, step, strict=True)]),
        pitch_per_step=kept_on_most([one.pitch / down for (_, one), down in zip(walls, step, strict=True)]),
        floor_spacing=max((float(np.nanmax(one.spacing)) for one in floors), default=None),
        floor_ridge=max((float(np.nanmax(one.ridge)) for one in floors), default=None),
    )


def step_for(surface: Surface, radius: float, *, ridge: float | None = None, spacing: float | None = None) -> float:
    """m, constant depth step that keeps a wanted ``ridge`` height m, ``spacing`` m, or both, on :data:`SHARE` of walls.

    ``radius`` m of the ball; one of the two is given.
    """
    steps = []
    if ridge is not None:
        steps.append(float(spacing_of_ridge(ridge, radius)) / surface.pitch_per_step)
    if spacing is not None:
        steps.append(spacing / surface.per_step)
    return min(steps)


def _marks(before: Contour, contour: Contour, job: Job) -> ToolMarks | None:
    """Marks of ``contour`` beside those of the contour ``before``; None where they lie nowhere beside each other."""
    tool = job.tool_1 if contour.forming_tool == 1 or job.tool_2 is None else job.tool_2
    lift = [0.0, 0.0, contour.holder_height - before.holder_height]  # over a die the sheet comes down
    contacts = _beside(contour.contact + lift, before.contact, closed=before.closed)
    centres = _beside(contour.forming_tip + lift, before.forming_tip, closed=before.closed)  # all by the radius higher
    spacing = np.linalg.norm(contacts, axis=1)
    pitch = np.sqrt(spacing * np.linalg.norm(centres, axis=1))
    if not np.isfinite(pitch).any():
        return None
    after, first = np.roll(contour.forming_tip, -1, axis=0), contour.forming_tip
    way = np.linalg.norm(after - first, axis=1)
    if not contour.closed:
        way[-1] = 0.0
    step = np.abs(centres[:, 2])
    return ToolMarks(step, spacing, ridge_height(pitch, tool.ball_radius), pitch, way, makes_floor(contour))


def _beside(points: Array, line: Array, *, closed: bool) -> Array:
    """(N, 3) m from the ``line`` (M, 3) to ``points`` (N, 3), the shortest way; NaN beyond the ends of an open line,
    where nothing runs."""
    nearest = KDTree(line).query(points)[1]
    count = len(line)
    found = np.full(points.shape, np.inf)
    beyond = np.zeros(len(points), dtype=bool)
    for first in (nearest - 1, nearest):  # the pieces before and after the nearest corner
        there = np.ones(len(points), dtype=bool) if closed else (first >= 0) & (first < count - 1)
        begin = line[first % count]
        along = line[(first + 1) % count] - begin
        share = ((points - begin) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
        way = points - begin - np.clip(share, 0.0, 1.0)[:, None] * along
        nearer = there & ((way**2).sum(axis=1) < (found**2).sum(axis=1))
        found = np.where(nearer[:, None], way, found)
        if not closed:
            beyond |= there & (((nearest == 0) & (share <= 0.0)) | ((nearest == count - 1) & (share >= 1.0)))
    found[beyond] = np.nan
    return found


def _quantile(values: Array, way: Array) -> float:
    """Smallest of ``values`` (N,) that :data:`SHARE` of the ``way`` (N,) does not exceed; NaN counts as nothing, and
    is what comes of nothing."""
    known = np.isfinite(values)
    if not known.any():
        return float("nan")
    values, way = values[known], way[known]
    order = np.argsort(values)
    reached = np.cumsum(way[order])
    at = np.searchsorted(reached, SHARE * reached[-1] * (1.0 - 1e-12))
    return float(values[order][min(at, len(order) - 1)])
