"""Does a tool run into something with its shank or holder? Formed sheet, flat sheet and frame of the clamp.

While a contour is formed, the sheet is taken to have its final shape around it, or in an earlier stage that of the
stage, and to be flat at the level of the contact inside. A backing plate lies under the sheet, which is met first. The
frame of the clamp stands on the sheet around its opening (``clamp.height`` of the rig).

A shank no wider than the tip of an upright tool meets nothing that the tip does not meet: there the wider shank and the
holder count. A plan is refused only for sizes that job and rig tell; of assumed ones there is a warning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


def check_shank(
    contours: Sequence[Contour], target: HeightMap, job_file: JobFile
) -> tuple[ShankClearance | None, tuple[str, ...]]:
    """The nearest that shank and holder of a tilted tool come to anything, and a warning where they would run into it
    if what is assumed of them is so; None where no contour is tilted.

    Raises
    ------
    IsfError : SHANK_COLLISION with the part of the tool, the place and an advice, where job and rig tell all sizes that
        are involved
    """
    tilted = [contour for contour in contours if contour.tilted]
    if not tilted:
        return None, ()
    tool, rig = job_file.job.tool_1, job_file.rig
    solid, frame = tool_solid(tool), clamp_frame(rig)
    last = max(contour.stage for contour in contours)
    stages = {contour.stage for contour in tilted}
    shapes = {k: target if k == last else _stage_shape(contours, k, target) for k in stages}
    nearest = _nearest_tilted(tilted, shapes, frame, solid)
    if nearest.distance >= -TOLERANCE:
        return nearest, ()
    certain = _told_of(tool, solid)
    sure = _nearest_tilted(tilted, shapes, _told_frame(frame, rig), certain) if certain else None
    if sure is not None and sure.distance < -TOLERANCE:
        what, where, _ = _tilted_collision(sure, tilted, rig)
        raise IsfError(
            ErrorCode.SHANK_COLLISION,
            what,
            where=where,
            advice="lower tool_axis.largest_tilt, or use a longer tool (tool_1.stick_out) or a thinner one "
            "(tool_1.shank_radius, tool_1.holder)",
        )
    what, where, framed = _tilted_collision(nearest, tilted, rig)
    return nearest, (f"{what}, {where}, {_assumed(nearest, tool, 'tool_1', rig, framed=framed)}",)


def _nearest_tilted(
    contours: Sequence[Contour], shapes: Mapping[int, HeightMap], frame: Array, solid: ToolSolid
) -> ShankClearance:
    """The nearest that ``solid`` comes to anything along tilted contours, in the ``shapes`` of their stages."""
    found = ShankClearance(float("inf"), np.full(3, np.nan), solid.names[0], contours[0].index, 0, solid)
    for contour in contours:
        for k in _poses(contour):
            tip, axis, level = contour.forming_tip[k], contour.forming_axis[k], float(contour.contact[k, 2])
            distance, place, part = solid.nearest(shapes[contour.stage], frame, tip, axis, level)
            if distance < found.distance:
                found = ShankClearance(distance, place, solid.names[part], contour.index, k, solid)
    return found


def _tilted_collision(found: ShankClearance, contours: Sequence[Contour], rig: Rig) -> tuple[str, str, bool]:
    """What is ``found``, where, and whether it is with the frame of the clamp."""
    framed = bool(found.place[2] > 0.0) and _in_frame(found.place, rig)
    contour = next(one for one in contours if one.index == found.contour)
    what, where = _told(found, "tilted tool", found.place, contour, framed=framed)
    return what, where, framed


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
        sure = _nearest_of_all(own, side, shape, _told_frame(frame, rig), certain) if certain else None
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
    what, where = _told(found, f"upright tool_{side.forming_tool}", place, contour, framed=framed)
    return what, where, framed


def _told(found: ShankClearance, tool: str, place: Array, contour: Contour, *, framed: bool) -> tuple[str, str]:
    """What is ``found`` at ``place`` (3,) m of frame ``sheet``, and where on the path."""
    met = "the frame of the clamp" if framed else "the sheet"
    return (
        f"the {found.part} of the {tool} would run {-1e3 * found.distance:.2f} mm into {met} at {place_text(place)}",
        f"{contour_label(found.contour)} with the tip at {place_text(contour.forming_tip[found.point])}",
    )


def _assumed(found: ShankClearance, tool: ToolSpec, name: str, rig: Rig, *, framed: bool) -> str:
    """On what it depends that a collision is one, and what to write so that it does not."""
    conditions, fields = [], []
    if found.part == SHANK and _wide(tool):
        conditions.append("if the shank is that wide down to the ball")
    else:
        length, radius = (1e3 * size for size in ASSUMED_HOLDER)
        if found.part == SHANK and tool.shank_radius is None:
            conditions.append(f"if the shank has the radius of the tip, {1e3 * tool.radius:g} mm")
            fields.append(f"{name}.shank_radius")
        if tool.stick_out is None:
            conditions.append(f"if the holder begins {1e3 * ASSUMED_STICK_OUT:g} mm above the tip")
            fields.append(f"{name}.stick_out")
        if found.part != SHANK and not tool.holder:
            conditions.append(f"if the holder is {length:g} mm long with a radius of {radius:g} mm")
            fields.append(f"{name}.holder")
    if framed and not _height_told(rig):
        conditions.append(f"if the frame of the clamp is {1e3 * rig.clamp.height:g} mm high")
        fields.append("clamp.height of the rig")
    told = " and ".join(conditions)
    return f"{told}; that is assumed: say what it is in {' and '.join(fields)}" if fields else told


def _height_told(rig: Rig) -> bool:
    return "height" in rig.clamp.model_fields_set


def _told_frame(frame: Array, rig: Rig) -> Array:
    """Of ``frame`` the points that are where they are for sure: its foot is on the sheet."""
    return frame if _height_told(rig) else frame[frame[:, 2] <= 0.0]


def _wide(tool: ToolSpec) -> bool:
    """A shank that is wider than the tip; it may have a neck, which no field describes."""
    return tool.shank_radius is not None and tool.shank_radius > tool.radius


def _told_of(tool: ToolSpec, solid: ToolSolid) -> ToolSolid | None:
    """Of ``solid`` the parts whose size and place the job tells, a wide shank left out; None: of none."""
    if tool.stick_out is None:
        return None
    shank, holder = tool.shank_radius is not None and not _wide(tool), bool(tool.holder)
    return _parts_of(solid, [k for k, part in enumerate(solid.names) if (shank if part == SHANK else holder)])


def _parts_of(solid: ToolSolid, chosen: Sequence[int]) -> ToolSolid | None:
    return ToolSolid(solid.parts[chosen], tuple(solid.names[k] for k in chosen), solid.ball) if chosen else None


def _beyond_the_tip(tool: ToolSpec) -> ToolSolid | None:
    """What of an upright tool reaches further to the side than its tip; None: nothing, or nothing is told of it."""
    whole = tool_solid(tool)
    told = tool.stick_out is not None or bool(tool.holder)
    return _parts_of(whole, [k for k, part in enumerate(whole.names) if (_wide(tool) if part == SHANK else told)])


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
    for k in _poses(contour):
        distance, place, part = solid.nearest(shape, more, tips[k], UPRIGHT, float(contact[k, 2]))
        if distance < nearest.distance:
            nearest = ShankClearance(distance, place, solid.names[part], contour.index, k, solid)
    return nearest


def _poses(contour: Contour) -> range:
    """Points of a contour that are looked at."""
    spacing = float(contour.arc_length()[-1]) / max(len(contour) - 1, 1)
    return range(0, len(contour), max(1, round(POSES / max(spacing, 1e-9))))


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
