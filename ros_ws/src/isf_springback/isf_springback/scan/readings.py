"""What a scan says of a part in work: errors around one contour, on the wall above it and on the bottom inside it, and
remarks about the shape as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, Process
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_springback.loop_path import LoopPath, nearest_points
from isf_springback.scan import sections
from isf_springback.scan.formed_shape import OPENING_DEPTH, PITCH, FormedShape, regions
from isf_springback.scan.sections import heights_at

CONTOURS_PER_PLACE = 4
"""Contours that make the wall at one place: the ball touches it again and again."""
PLACES = 36
"""Places around a contour at which bias is kept (assumed)."""
WALL_REACH = (-0.75e-3, 0.1e-3)
"""m from the contact, where the wall is read: passed by the contact within the last two contours."""
READING_DEVIATION = 0.15e-3
"""m, of an error read in a section: 0.05 mm of the scanner (published: Lu 2016, 3.5.2), the rest for what one contour
leaves of the next one's wall (assumed)."""

WALL_LENGTH = 40e-3
"""m of wall in plan, up from the contact, over which its movement is summed at most."""
SMALLEST_ADVANCE = 0.1e-3
"""m in plan between the contacts of two scans, below which movement cannot be told from noise (assumed)."""
LARGEST_PILLOW = 0.5e-3
"""m by which a place of the bottom may differ from the rest; what lies farther off was formed before (assumed)."""
SAME_DEPTH = 0.05e-3
"""m, what lies this little over the tip is as deep as the tip."""
BOTTOM_HEIGHT = 0.1e-3
"""m over the lowest place of the target, where its bottom begins."""


@dataclass(frozen=True)
class Reading:
    """Errors read around one contour, M places: formed minus intended height on the wall and on the bottom, m."""

    place: Array
    wall: Array
    bottom: Array


def read_errors(
    contour: Contour,
    shape: FormedShape,
    target: HeightMap,
    radius: float,
    began: HeightMap | None = None,
    *,
    finished: bool = False,
) -> Reading:
    """Errors on the wall just above the contact and on the bottom, at :data:`PLACES` places of ``contour``.

    Where the stage ``began`` with a shape (None: the flat blank) there is a bottom as far as that was even, and no
    deeper than the tool is now. The bottom is to lie where the tip of ``contour`` was, or, that of a
    ``finished`` part, where the target does: later contours have formed it deeper.
    """
    path = LoopPath.of(contour)
    directions = sections.directions_of(contour, path.even_positions(PLACES))
    angle = path.at(contour.wall_angle, directions.position)
    step = sections.STEP
    reach = step * np.arange(-12, round(20e-3 / step) + 1, dtype=np.float64)
    formed = sections.vertical_sections(shape.surface, directions, reach)
    wanted = sections.vertical_sections(target, directions, reach)
    near = (reach >= WALL_REACH[0] - 1e-9) & (reach <= WALL_REACH[1] + 1e-9)
    wall = median_of_rows(formed[:, near] - wanted[:, near])
    tip = radius * np.sin(angle)
    level = directions.tip_level
    inner = _inner(contour)
    inside = (reach[None, :] >= tip[:, None] - 0.5e-3) & (reach[None, :] <= tip[:, None] + inner)
    up = -contour.push_sign
    flat = up * wanted <= up * level[:, None] + SAME_DEPTH
    if began is not None:
        before = sections.vertical_sections(began, directions, reach)
        low = before.min(axis=1, initial=np.inf, where=inside)
        high = before.max(axis=1, initial=-np.inf, where=inside)
        flat &= ((high - low <= LARGEST_PILLOW) & (low >= level - SAME_DEPTH))[:, None]
    intended = wanted if finished else level[:, None]
    bottom = np.where(inside & flat, formed - intended, np.nan)
    middle = median_of_rows(bottom)
    # By area: beside the tip the bottom lies deeper than in the middle, and there is more of it.
    area = np.maximum(tip[:, None] + 2.0 * inner - reach[None, :], 0.0)
    pillow = np.clip(bottom - middle[:, None], -LARGEST_PILLOW, LARGEST_PILLOW)
    bottom = middle + _mean(pillow, area)
    return Reading(directions.origin, wall, bottom)


def movement_to_come(
    contour: Contour,
    shape: FormedShape,
    before: Contour,
    shape_before: FormedShape,
    contours: int,
    target: HeightMap,
    floor: float,
    radius: float,
) -> tuple[Array, Array]:
    """How far the wall that ``contour`` makes will still rise while the part below it is formed, and the standard
    deviation of that, at :data:`PLACES` places of ``contour``; (M,) m each, NaN where it cannot be told.

    ``shape`` is the one after ``contour``, ``shape_before`` that after the earlier contour ``before`` of the same wall,
    since which ``contours`` of it were formed; it ends in a ``floor`` at a height of m.
    What every place of the wall has moved by between the two, from the contact up to the opening, is what one place
    will move by while the contact leaves it behind, as long as the process stays the same: the movement summed over the
    wall in steps of the way of the contact in plan. It is summed over no more wall than is still to come, and not where
    the ball touches it again, nor beside the opening, within the ball's ``radius`` m: the sheet is drawn over an edge
    there that the coming wall does not have.
    """
    path = LoopPath.of(contour)
    directions = sections.directions_of(contour, path.even_positions(PLACES))
    away = sections.STEP * np.arange(round(WALL_LENGTH / sections.STEP), dtype=np.float64)
    moved = sections.vertical_sections(shape.surface, directions, -away)
    moved = moved - sections.vertical_sections(shape_before.surface, directions, -away)
    came_from = before.contact[nearest_points(directions.origin, before.contact[:, :2]), :2]
    advance = np.linalg.norm(directions.origin - came_from, axis=1)
    bottom = sections.vertical_sections(target, directions, away) <= floor + BOTTOM_HEIGHT
    to_come = np.where(bottom.any(axis=1), sections.STEP * np.argmax(bottom, axis=1), WALL_LENGTH)
    begin = np.maximum(advance - WALL_REACH[0], CONTOURS_PER_PLACE * advance / contours)
    wall = np.logical_and.accumulate(sections.vertical_sections(target, directions, -away) < -OPENING_DEPTH, axis=1)
    end = np.minimum(begin + to_come, sections.STEP * wall.sum(axis=1) - radius)
    counts = (away >= begin[:, None]) & (away <= end[:, None])
    known = counts & np.isfinite(moved)
    seen = (known.sum(axis=1) >= np.maximum(0.5 * counts.sum(axis=1), 1)) & (advance >= SMALLEST_ADVANCE)
    steps = sections.STEP * counts.sum(axis=1) / np.maximum(advance, SMALLEST_ADVANCE)
    movement = steps * np.where(known, moved, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    cells = np.maximum(sections.STEP * known.sum(axis=1) / PITCH, 1.0)
    noise = np.hypot(shape.noise, shape_before.noise)
    # A change of the process, as of the push between the two scans, is an error that all places share.
    deviation = np.hypot(np.sqrt(PLACES) * READING_DEVIATION, steps * noise / np.sqrt(cells))
    return np.where(seen, movement, np.nan), deviation


def _inner(contour: Contour) -> float:
    """m, how far inside the tip the bottom is read: half of the way to the middle."""
    place = contour.forming_tip[:, :2]
    return float(np.clip(0.25 * np.ptp(place, axis=0).min(), 0.5e-3, 15e-3))


def _mean(values: Array, weight: Array) -> Array:
    """(M,) weighted mean of the known values of each row; NaN where fewer than two are known."""
    known = np.isfinite(values)
    total = np.where(known, weight, 0.0).sum(axis=1)
    enough = (known.sum(axis=1) >= 2) & (total > 0.0)
    result = np.full(len(values), np.nan)
    result[enough] = np.where(known, weight * values, 0.0).sum(axis=1)[enough] / total[enough]
    return result


def median_of_rows(values: Array) -> Array:
    """(M,) median of the known ``values`` (M, n) of each row; NaN where fewer than two are known."""
    result = np.full(len(values), np.nan)
    enough = np.isfinite(values).sum(axis=1) >= 2
    result[enough] = np.nanmedian(values[enough], axis=1)
    return result


RIM_SAG = 0.5e-3
"""m below the plan at which the rim is told (the usual tolerance of a formed part is 1 mm, Lu 2016, 1.1)."""
PILLOW = 0.3e-3
"""m by which the middle of the bottom may stand over its edge."""


def shape_remarks(
    shape: FormedShape, target: HeightMap, contour: Contour, job_file: JobFile, began: HeightMap | None = None
) -> tuple[str, ...]:
    """Remarks on the part after ``contour``, in a stage that ``began`` with a shape."""
    level = float(contour.forming_tip[:, 2].min())
    masks = regions(target)
    places = np.stack(np.meshgrid(target.x, target.y), axis=-1)
    formed = heights_at(shape.surface, places)
    error = formed - np.maximum(target.z, level)
    # a bottom that a stage before has formed is no sheet that stands up between the walls
    pillow = () if began is not None else _pillow(formed, target, level, passes=contour.floor_passes)
    return (*_rim(error[masks["rim"]], job_file), *pillow)


def _rim(error: Array, job_file: JobFile) -> tuple[str, ...]:
    known = error[np.isfinite(error)]
    if len(known) < 20:
        return ()
    sag = -float(np.mean(known))
    if sag < RIM_SAG:
        return ()
    job = job_file.job
    better = "a backing plate with an opening close to the path"
    if job.process_type is Process.SPIF:
        better += ", or two tools (DSIF)"
    if job.backing_plate is not None:
        better = "a smaller opening of the backing plate"
    return (
        f"the rim lies {1e3 * sag:.1f} mm below the plan: sheet outside the path bends and no tool lifts it; {better} "
        "would hold it",
    )


def _pillow(formed: Array, target: HeightMap, level: float, *, passes: bool) -> tuple[str, ...]:
    """Middle of the bottom (where the target is deeper than the tool has been) against its edge."""
    bottom = target.z <= level + SAME_DEPTH
    if bottom.sum() < 200:
        return ()
    rows, columns = np.nonzero(bottom)
    centre = np.array([target.x[columns].mean(), target.y[rows].mean()])
    distance = np.hypot(target.x[columns] - centre[0], target.y[rows] - centre[1])
    height = formed[rows, columns]
    outer = np.quantile(distance, 0.8)
    edge, middle = height[distance > outer], height[distance < 0.3 * outer]
    edge, middle = edge[np.isfinite(edge)], middle[np.isfinite(middle)]
    if len(edge) < 10 or len(middle) < 10:
        return ()
    rise = float(middle.mean() - edge.mean())
    if rise < PILLOW:
        return ()
    better = "passes over the floor (path.floor_step), support from below (DSIF) or a smaller depth step would lower it"
    if passes:
        better = "the passes over the floor lower it"
    return (
        f"the middle of the bottom stands {1e3 * rise:.1f} mm over its edge (pillow): contours on the walls do not "
        f"reach it; {better}",
    )
