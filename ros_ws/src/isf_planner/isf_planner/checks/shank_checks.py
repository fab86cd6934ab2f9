"""Does a tool run into something with its shank or holder? Formed sheet, flat sheet and frame of the clamp.

While a contour is formed, the sheet is taken to have its final shape around it, or in an earlier stage that of the
stage, and to be flat at the level of the contact inside. A backing plate lies under the sheet, which is met first. The
frame of the clamp stands on the sheet around its opening (``clamp.height`` of the rig).

A shank no wider than the tip of an upright tool meets nothing that the tip does not meet: there the wider shank and the
holder count. A plan is refused only for sizes that job and rig tell; of assumed ones there is a warning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile
from isf_core.files.rig import Rig
from isf_core.files.tooling import ToolSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.tool_solid import ASSUMED_HOLDER, ASSUMED_STICK_OUT, ToolSolid, tool_solid
from isf_core.types import Array
from scipy.interpolate import RegularGridInterpolator, griddata

from isf_planner.forming.sides import Side, first_number, swapped
from isf_planner.part.mesh_checks import place_text

POSES = 5e-3
"""m of path between two poses that are looked at."""
TOLERANCE = 0.05e-3
"""m, by which a shank may seem to cut into a surface that is known by points."""
FRAME_PITCH = 2e-3
"""m between the points of the clamp's frame."""


@dataclass(frozen=True)
class ShankClearance:
    """Where shank and holder come nearest to anything.

    Attributes
    ----------
    distance : m ; place : (3,) m, of what they come near to ; part : name of the part of the tool
    contour, point : where on the path ; solid : shank and holder
    """

    distance: float
    place: Array
    part: str
    contour: int
    point: int
    solid: ToolSolid


def check_shank(contours: Sequence[Contour], target: HeightMap, job_file: JobFile) -> ShankClearance | None:
    """The nearest that shank and holder of a tilted tool come to anything; None where no contour is tilted.

    Raises
    ------
    IsfError : SHANK_COLLISION with the part of the tool, the place and an advice
    """
    if not any(contour.tilted for contour in contours):
        return None
    solid = tool_solid(job_file.job.tool_1)
    frame = clamp_frame(job_file.rig)
    last = max(contour.stage for contour in contours)
    shapes = {last: target}
    nearest: ShankClearance | None = None
    for contour in contours:
        if not contour.tilted:
            continue
        if contour.stage not in shapes:
            shapes[contour.stage] = _stage_shape(contours, contour.stage, target)
        spacing = float(contour.arc_length()[-1]) / max(len(contour) - 1, 1)
        for k in range(0, len(contour), max(1, round(POSES / max(spacing, 1e-9)))):
            found = solid.nearest(
                shapes[contour.stage],
                frame,
                contour.forming_tip[k],
                contour.forming_axis[k],
                float(contour.contact[k, 2]),
            )
            if nearest is None or found[0] < nearest.distance:
                nearest = ShankClearance(found[0], found[1], solid.names[found[2]], contour.index, k, solid)
    assert nearest is not None
    if nearest.distance < -TOLERANCE:
        framed = nearest.place[2] > 0.0 and _in_frame(nearest.place, job_file.rig)
        met = "the frame of the clamp" if framed else "the sheet"
        at = contours[nearest.contour].forming_tip[nearest.point]
        raise IsfError(
            ErrorCode.SHANK_COLLISION,
            f"the {nearest.part} of the tilted tool would run {-1e3 * nearest.distance:.2f} mm into {met} at "
            f"{place_text(nearest.place)}",
            where=f"{contour_label(nearest.contour)} with the tip at {place_text(at)}",
            advice="lower tool_axis.largest_tilt, or use a longer tool (tool_1.stick_out) or a thinner one "
            "(tool_1.shank_radius, tool_1.holder)",
        )
    return nearest


UPRIGHT = np.array([0.0, 0.0, 1.0])
SHANK = "shank"
"""Name of that part in a :class:`ToolSolid`."""


def check_upright(
    contours: Sequence[Contour], sides: Sequence[Side], target: HeightMap, job_file: JobFile
) -> tuple[str, ...]:
    """Warnings where an upright forming tool would run into something, if what is assumed of it is so.

    ``contours`` of the part itself, without those of earlier stages, whose walls are flatter. A tool of which the job
    tells neither ``stick_out`` nor ``holder`` has no length that could be too short: then its shank is looked at alone,
    where that is wider than the tip. In ADSIF the sheet is not in its final shape until the end: nothing is looked at.

    Raises
    ------
    IsfError : SHANK_COLLISION with the part of the tool, the place and an advice, where job and rig tell all sizes that
        are involved
    """
    job, rig = job_file.job, job_file.rig
    if job.process == "ADSIF":
        return ()
    warnings = []
    for number, side in enumerate(sides):
        tool, name = swapped(job, side.forming_tool).tool_1, f"tool_{side.forming_tool}"
        solid = _beyond_the_tip(tool)
        if solid is None:
            continue
        shape = _around(side, target, job)
        mine = range(first_number(sides, number), first_number(sides, number + 1))
        own = [contour for contour in contours if contour.feature in mine and not contour.tilted]
        frame = clamp_frame(rig) if side.forming_tool == 1 else np.empty((0, 3))
        found = _nearest_of_all(own, side, shape, frame, solid)
        if found is None:
            continue
        certain = _told_of(tool, solid)  # alone: what is assumed may reach further than what is sure, and hide it
        known = frame if _height_told(rig) else frame[frame[:, 2] <= 0.0]  # the frame's foot is on the sheet
        sure = _nearest_of_all(own, side, shape, known, certain) if certain else None
        if sure is not None:
            what, where, _ = _collision(sure, own, side, rig, framed=len(frame) > 0)
            raise IsfError(
                ErrorCode.SHANK_COLLISION,
                what,
                where=where,
                advice=f"use a longer tool ({name}.stick_out) or a thinner holder ({name}.holder)",
            )
        what, where, framed = _collision(found, own, side, rig, framed=len(frame) > 0)
        warnings.append(f"{what}, {where}, {_assumed(found, tool, name, rig, framed=framed)}")
    return tuple(warnings)


def _nearest_of_all(
    contours: Sequence[Contour], side: Side, shape: HeightMap, frame: Array, solid: ToolSolid
) -> ShankClearance | None:
    """The deepest that shank and holder run into anything; None where they run into nothing."""
    each = (_nearest(contour, side, shape, frame, solid) for contour in contours)
    found = min(each, key=lambda one: one.distance, default=None)
    return None if found is None or found.distance >= -TOLERANCE else found


def _collision(
    found: ShankClearance, contours: Sequence[Contour], side: Side, rig: Rig, *, framed: bool
) -> tuple[str, str, bool]:
    """What is ``found``, where, and whether it is with the frame of the clamp; ``framed``: there is one."""
    contour = next(one for one in contours if one.index == found.contour)
    place = side.in_sheet(found.place)
    framed = framed and bool(place[2] > contour.holder_height) and _in_frame(place, rig)
    met = "the frame of the clamp" if framed else "the sheet"
    what = (
        f"the {found.part} of the upright tool_{side.forming_tool} would run {-1e3 * found.distance:.2f} mm into {met} "
        f"at {place_text(place)}"
    )
    return (
        what,
        f"{contour_label(found.contour)} with the tip at {place_text(contour.forming_tip[found.point])}",
        framed,
    )


def _assumed(found: ShankClearance, tool: ToolSpec, name: str, rig: Rig, *, framed: bool) -> str:
    """On what it depends that a collision is one, and what to write so that it does not."""
    conditions, fields = [], []
    if found.part == SHANK:
        conditions.append("if the shank is that wide down to the ball")
    else:
        length, radius = (1e3 * size for size in ASSUMED_HOLDER)
        if tool.stick_out is None:
            conditions.append(f"if the holder begins {1e3 * ASSUMED_STICK_OUT:g} mm above the tip")
            fields.append(f"{name}.stick_out")
        if not tool.holder:
            conditions.append(f"if the holder is {length:g} mm long with a radius of {radius:g} mm")
            fields.append(f"{name}.holder")
    if framed and not _height_told(rig):
        conditions.append(f"if the frame of the clamp is {1e3 * rig.clamp.height:g} mm high")
        fields.append("clamp.height of the rig")
    told = " and ".join(conditions)
    return f"{told}; that is assumed: say what it is in {' and '.join(fields)}" if fields else told


def _height_told(rig: Rig) -> bool:
    return "height" in rig.clamp.model_fields_set


def _told_of(tool: ToolSpec, solid: ToolSolid) -> ToolSolid | None:
    """Of ``solid`` the parts whose size and place the job tells. A shank that is wider than the tip is none of them: it
    may have a neck, which no field describes."""
    if tool.stick_out is None or not tool.holder:
        return None
    return _parts_of(solid, [k for k, part in enumerate(solid.names) if part != SHANK])


def _parts_of(solid: ToolSolid, chosen: Sequence[int]) -> ToolSolid | None:
    return ToolSolid(solid.parts[chosen], tuple(solid.names[k] for k in chosen), solid.ball) if chosen else None


def _beyond_the_tip(tool: ToolSpec) -> ToolSolid | None:
    """What of an upright tool reaches further to the side than its tip; None: nothing, or nothing is told of it."""
    whole = tool_solid(tool)
    told = tool.stick_out is not None or bool(tool.holder)
    wide = whole.parts[0, 2] > tool.radius
    return _parts_of(whole, [k for k, part in enumerate(whole.names) if (wide if part == SHANK else told)])


def _around(side: Side, target: HeightMap, job: Job) -> HeightMap:
    """The sheet while a side is formed, as its tool sees it, on the grid of ``target``.

    The upper tool comes first: what the lower one forms is not there yet. Over a die it is the die's frame.
    """
    if side.forming_tool == 1 and side.base == 0.0:
        surface = side.surface
        flange = float(surface.z[0, 0])
        sampled = RegularGridInterpolator((surface.y, surface.x), surface.z, bounds_error=False, fill_value=flange)
        gx, gy = np.meshgrid(target.x, target.y)
        return HeightMap(target.x, target.y, np.asarray(sampled((gy, gx))))
    face = job.sheet.thickness if side.forming_tool == 2 else 0.0  # the lower tool meets the other face
    gx, gy = np.meshgrid(target.x, target.y)
    seen = side.seen(np.stack([gx, gy, target.z - face], axis=-1))
    return HeightMap(target.x, target.y, seen[..., 2])


def _nearest(contour: Contour, side: Side, shape: HeightMap, frame: Array, solid: ToolSolid) -> ShankClearance:
    """Where shank and holder come nearest along a contour, the place as the forming tool sees it; infinitely far where
    they begin above everything."""
    holder = np.array([0.0, 0.0, contour.holder_height])  # over a die: the frame of the clamp travels with the holder
    tips, contact = (side.seen(points + holder) for points in (contour.forming_tip, contour.contact))
    more = frame + holder
    highest = max(float(np.nanmax(shape.z)), float(more[:, 2].max(initial=-np.inf)))
    nearest = ShankClearance(float("inf"), np.full(3, np.nan), solid.names[0], contour.index, 0, solid)
    if float(tips[:, 2].min()) + solid.ball + float(solid.parts[0, 0]) >= highest:
        return nearest
    spacing = float(contour.arc_length()[-1]) / max(len(contour) - 1, 1)
    for k in range(0, len(contour), max(1, round(POSES / max(spacing, 1e-9)))):
        distance, place, part = solid.nearest(shape, more, tips[k], UPRIGHT, float(contact[k, 2]))
        if distance < nearest.distance:
            nearest = ShankClearance(distance, place, solid.names[part], contour.index, k, solid)
    return nearest


def clamp_frame(rig: Rig) -> Array:
    """(M, 3) m, points of the inner faces and edges of the frame around the free sheet."""
    (width, depth), height = rig.clamp.size, rig.clamp.height
    z = np.linspace(0.0, height, max(2, int(np.ceil(height / FRAME_PITCH)) + 1))
    along = [np.linspace(-size / 2, size / 2, max(2, int(np.ceil(size / FRAME_PITCH)) + 1)) for size in (width, depth)]
    ring = [
        *(np.column_stack([along[0], np.full_like(along[0], side * depth / 2)]) for side in (-1.0, 1.0)),
        *(np.column_stack([np.full_like(along[1], side * width / 2), along[1]]) for side in (-1.0, 1.0)),
    ]
    plan = np.vstack(ring)
    return np.column_stack([np.repeat(plan, len(z), axis=0), np.tile(z, len(plan))])


def _in_frame(place: Array, rig: Rig) -> bool:
    return bool((np.abs(place[:2]) >= 0.5 * np.array(rig.clamp.size) - 1e-9).any())


def _stage_shape(contours: Sequence[Contour], stage: int, target: HeightMap) -> HeightMap:
    """The sheet after an earlier ``stage``, from its contacts and the flat sheet at the clamp."""
    contact = np.vstack([contour.contact for contour in contours if contour.stage == stage])
    gx, gy = np.meshgrid(target.x, target.y)
    edge = np.zeros(gx.shape, dtype=bool)
    edge[[0, -1]] = edge[:, [0, -1]] = True
    known = np.vstack([contact, np.column_stack([gx[edge], gy[edge], np.zeros(int(edge.sum()))])])
    z = griddata(known[:, :2], known[:, 2], (gx, gy), method="linear", fill_value=0.0)
    return HeightMap(target.x, target.y, z)
