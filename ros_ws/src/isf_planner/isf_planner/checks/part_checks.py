"""Can this part be formed on this rig with these tools? Size, wall angle, fillets, tool travel, narrow pockets.

Pockets: where the tip may be at a level lies within what of the part is below the level. So every section of the mesh
around lower ground holds a loop of the tip at that level, or the pocket is too narrow for the tool there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job
from isf_core.files.material import Material
from isf_core.files.rig import Rig
from isf_core.files.tooling import ToolSpec
from isf_core.geometry.tool_axis import point_on_axis, tilt_of
from isf_core.types import Array

from isf_planner.checks import arm_checks, leg_checks
from isf_planner.checks.mesh_slicing import MeshLoop, slice_mesh
from isf_planner.forming import permission
from isf_planner.forming.sides import Side, first_number, holder
from isf_planner.loops.sections import RoughLoop
from isf_planner.part.mesh_checks import PlacedPart, place_text, steepest_wall
from isf_planner.part.meshes import Mesh
from isf_planner.surface import surface_kernels, tip_surface
from isf_planner.surface.target_surface import TargetSurface

ANGLE_MARGIN = 0.95
"""Wall angles above this part of the limit are warned of."""

UNREACHED_TOLERANCE = 0.1e-3
"""m, material left by the tool in a fillet before it is worth a warning."""

PRESSING_TOLERANCE = 0.1e-3
"""m, by which the support tool may press beside its contact before it is worth a warning."""

BENT = float(np.radians(20.0))
"""rad, between a steep wall and the one below it, from which on the tent effect is warned of (assumed)."""

EVEN = float(np.radians(10.0))
"""rad, that a wall may change its angle by and still be one."""

SHALLOWEST = float(np.radians(10.0))
"""rad; what is flatter is a floor."""

NOWHERE = -10.0
"""m, height of nodes that are to be left out."""

FLAT_BALLS = 16
"""Balls around the flat of a support tip."""


def check_fit(part: PlacedPart, job: Job, rig: Rig) -> None:
    """The formed region keeps one tool radius from the clamp; IsfError PART_DOES_NOT_FIT otherwise."""
    radius = max(job.tool_1.radius, job.tool_2.radius if job.tool_2 else 0.0)
    formed = part.mesh.vertices[part.mesh.vertices[:, 2] < -1e-6]
    room = np.asarray(rig.clamp.size) / 2 - radius
    excess = np.abs(formed[:, :2]) - room
    if excess.max() > 0:
        worst = int(np.argmax(excess.max(axis=1)))
        raise IsfError(
            ErrorCode.PART_DOES_NOT_FIT,
            f"the formed region comes {excess.max() * 1e3:.1f} mm too close to the clamp "
            f"(free sheet {rig.clamp.size[0] * 1e3:.0f} x {rig.clamp.size[1] * 1e3:.0f} mm, "
            f"tool radius {radius * 1e3:.1f} mm)",
            where=f"mesh at {place_text(formed[worst])}",
            advice="turn or shrink the part, or use a larger clamp",
        )


def check_wall_angle(mesh: Mesh, job: Job, material: Material, *, alone: bool = True) -> tuple[str, ...]:
    """Warnings for walls of a part formed in one pass near what may be planned; IsfError WALL_TOO_STEEP beyond it.

    Of a part in stages nothing is looked at without a ``wall_angle_limit``: what each stage may add is known with its
    shape (:mod:`isf_planner.forming.permission`). ``alone``: one upper tool forms the whole part, so that stages can.
    """
    staged = bool(job.path.stages) or job.path.morph is not None
    if staged and job.wall_angle_limit is None:
        return ()
    limit = job.wall_angle_limit or material.max_wall_angle
    angle, place = steepest_wall(mesh)
    where = place_text(place)
    steepest, most = np.degrees(angle), np.degrees(limit)
    if angle > limit:
        one_pass = "" if staged else " in one pass"
        raise IsfError(
            ErrorCode.WALL_TOO_STEEP,
            f"the wall is {steepest:.1f} deg steep, {most:.1f} deg may be planned{one_pass}",
            where=f"mesh at {where}",
            advice=_of_steep_wall(angle, job, material, alone=alone, staged=staged),
        )
    if angle > material.max_wall_angle + permission.EXACT and not staged:
        bears = f"{material.name} bears {np.degrees(material.max_wall_angle):.1f} deg in one pass"
        return (f"the wall at {where} is {steepest:.1f} deg steep, which wall_angle_limit permits: {bears}",)
    if angle > ANGLE_MARGIN * limit:
        return (f"the wall at {where} is {steepest:.1f} deg steep, close to the limit of {most:.1f} deg",)
    return ()


def _of_steep_wall(angle: float, job: Job, material: Material, *, alone: bool, staged: bool) -> str:
    """What to do about a wall of ``angle`` rad that may not be planned."""
    given = job.wall_angle_limit is not None
    if staged:
        return "leave wall_angle_limit out (every stage is then looked at by itself), or raise it: the sheet may tear"
    ways = []
    if alone and job.process in ("SPIF", "DSIF") and angle > material.max_wall_angle:
        without = ", without wall_angle_limit" if given else ""
        stages = permission.stages_text(angle, material.max_wall_angle)
        ways.append(f"form it in several passes ({stages}, or path.morph: {{}}{without})")
    ways += ["make the wall flatter", f"{'raise' if given else 'set'} wall_angle_limit to try it in one pass"]
    return f"{', or '.join(ways)}: the sheet may tear"


def check_reach(
    surface: TargetSurface, tip_height: Array, depth: float, radius: float
) -> tuple[float, tuple[str, ...]]:
    """Most material (m) that the tool leaves, and warnings where; IsfError PART_TOO_SMALL_FOR_TOOL when it cannot reach
    the bottom.

    ``tip_height`` as from :func:`isf_planner.surface.tip_surface.tip_grid`; ``depth`` and ``radius`` in m.
    """
    row, column = np.unravel_index(int(np.argmin(surface.z)), surface.z.shape)
    deepest = np.array([surface.x[column], surface.y[row]])
    missing = depth - tip_surface.reached_depth(surface, tip_height, depth, radius)
    if missing > 0.0:
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"the tool of radius {radius * 1e3:.2f} mm stops {missing * 1e3:.2f} mm above the deepest point",
            where=f"mesh at {place_text(np.append(deepest, -depth))}",
            advice="use a smaller tool, or a larger radius or floor in the part",
        )
    left, place = tip_surface.unreached(surface, tip_height, radius, UNREACHED_TOLERANCE)
    if left <= UNREACHED_TOLERANCE:
        return left, ()
    return left, (
        f"at {place_text(place)} a radius of the part is smaller than the tool ({radius * 1e3:.2f} mm): "
        f"up to {left * 1e3:.2f} mm of material remain there",
    )


def check_machine(contours: tuple[Contour, ...], job: Job, rig: Rig) -> None:
    """The rig can move its tools so: within travel, axes, speed of legs, joints and bodies of arms.

    Raises
    ------
    IsfError : PART_DOES_NOT_FIT, LEGS_TOO_FAST, and as :func:`isf_planner.checks.arm_checks.check_arms`
    """
    check_travel(contours, rig)
    check_axes(contours, rig, job.tool_1.ball_radius)
    if rig.legs is not None:
        leg_checks.check_legs(contours, rig, job.tool_1.ball_radius)
    if rig.kinematics == "arm":
        arm_checks.check_arms(contours, job, rig)


def check_travel(contours: tuple[Contour, ...], rig: Rig) -> None:
    """All tips stay within the rig's travel; IsfError PART_DOES_NOT_FIT otherwise."""
    limit = np.asarray(rig.limits.travel)
    for contour in contours:
        for name, tips in (("forming", contour.forming_tip), ("support", contour.support_tip)):
            if len(tips) and (np.abs(tips) > limit).any():
                worst = int(np.argmax((np.abs(tips) - limit).max(axis=1)))
                text = " x ".join(f"{value * 1e3:.0f}" for value in limit)
                raise IsfError(
                    ErrorCode.PART_DOES_NOT_FIT,
                    f"the {name} tool would leave the travel of the rig (+-{text} mm)",
                    where=f"{contour_label(contour.index)} at {place_text(tips[worst])}",
                    advice="shrink the part, or correct limits.travel of the rig",
                )


def check_axes(contours: Sequence[Contour], rig: Rig, radius: float) -> None:
    """The rig's axes (cylinders, joints) make every pose of the tools; IsfError PART_DOES_NOT_FIT otherwise.

    ``radius`` m of the ball of a tilted forming tool.
    """
    if rig.kinematics == "gantry_xyz_uvw" and not any(contour.tilted for contour in contours):
        return  # its axes are the coordinates, which check_travel looks at
    for contour in contours:
        for tool, tips in (
            (contour.forming_tool, contour.forming_tip),
            (3 - contour.forming_tool, contour.support_tip),
        ):
            kinematics = rig.make_kinematics()[tool - 1]
            axis = contour.forming_axis if tool == contour.forming_tool else np.empty((0, 3))
            if len(axis):
                within = kinematics.reachable(point_on_axis(tips, axis, radius), tilt_of(axis))
            else:
                within = kinematics.reachable(tips) if len(tips) else np.ones(0, dtype=bool)
            if not within.all():
                worst = int(np.argmin(within))
                leaning = (axis[worst], radius) if len(axis) else None
                raise IsfError(
                    ErrorCode.PART_DOES_NOT_FIT,
                    axis_reason(rig, tips[worst], tool, leaning),
                    where=f"{contour_label(contour.index)} at {place_text(tips[worst])}",
                    advice="move the part, or the table of the machine"
                    + (", or lower tool_axis.largest_tilt" if len(axis) else ""),
                )


def axis_reason(rig: Rig, tip: Array, tool: int = 1, leaning: tuple[Array, float] | None = None) -> str:
    """Why the axes of ``tool`` (1 or 2) cannot make the ``tip`` (3,) m; empty when they can.

    ``leaning``: axis (3,) and ball radius m of a tilted tool; None: upright.
    """
    kinematics = rig.make_kinematics()[tool - 1]
    try:
        if leaning is None:
            kinematics.positions(tip)
        else:
            kinematics.positions(point_on_axis(tip, *leaning), tilt_of(leaning[0]))
    except IsfError as error:
        return error.what
    return ""


def check_slopes(contours: Sequence[Contour], job: Job) -> tuple[str, ...]:
    """Warning where a shallow wall is formed below a steep one, which it pulls inwards (tent effect, Behera 2015).

    ``contours`` of the part itself. A steep wall is two tool radii deep, a shallow one three wide seen from above, and
    what bends between them one diameter at most. By the median angle at a depth: a part that is so on one side alone is
    not told.
    """
    if job.process != "SPIF" or job.path.morph is not None or job.path.finishing_passes:
        return ()
    radius = job.tool_1.ball_radius
    found = []
    for feature in {contour.feature for contour in contours}:
        mine = [contour for contour in contours if contour.feature == feature]
        height, angles = (
            np.concatenate(rows) for rows in zip(*((c.contact[:, 2], c.wall_angle) for c in mine), strict=True)
        )
        level = np.floor(-height / job.path.incremental_depth)
        levels = np.unique(level)
        z, angle = (np.array([np.median(values[level == one]) for one in levels]) for values in (height, angles))
        run = np.concatenate([[0.0], np.cumsum(-np.diff(z) / np.tan(np.maximum(angle[1:], 0.01)))])
        for k in np.flatnonzero(z < z[0] - 2.0 * radius):
            steep = angle[(z <= z[k] + 2.0 * radius) & (z >= z[k])].min()
            below = angle[(run >= run[k] + 2.0 * radius) & (run <= run[k] + 5.0 * radius)]
            if run[-1] < run[k] + 5.0 * radius or not len(below) or np.ptp(below) > EVEN or below.min() < SHALLOWEST:
                continue
            if steep - below.max() >= BENT:
                found.append((round(float(steep), 2), -float(z[k]), float(below.max())))
    if not found:
        return ()
    steep, depth, shallow = max(found)
    return (
        f"a wall of {np.degrees(shallow):.0f} deg is formed below one of {np.degrees(steep):.0f} deg, from "
        f"{1e3 * depth:.0f} mm of depth on, and pulls it inwards (tent effect), flat walls by millimetres, round "
        "ones by less; path.finishing_passes: 1 forms it back, see what is left with --sheet shell_coarse",
    )


def check_islands(sides: Sequence[Side]) -> None:
    """No island is left to be formed around when they are to be formed from the other side.

    Raises
    ------
    IsfError : ISLAND_WITHOUT_FLOOR with the place of the largest one
    """
    found = [
        (side, loop)
        for side in sides
        for feature in side.tree.features
        for loop in [side.tree.loops[feature.loops[-1]]]
        if feature.island
    ]
    if not found:
        return
    side, loop = max(found, key=lambda one: float(np.ptp(one[1].points, axis=0).max()))
    raise IsfError(
        ErrorCode.ISLAND_WITHOUT_FLOOR,
        f"{len(found)} islands do not stand on a plane floor parallel to the sheet: where the tools swap is not clear",
        where=f"island around {place_text(side.in_sheet(loop.tip).mean(axis=0))}",
        advice="give the pocket a plane floor all around the island, or use path.islands: around",
    )


def left_by_springback(sides: Sequence[Side], job: Job) -> tuple[str, ...]:
    """Warning where nothing keeps a floor at its height until what stands on it is formed from the other side."""
    floors = sorted({side.base for side in sides if side.base != 0.0})
    if not floors or job.springback.method != "none" or "sheet" in job.path.compensation:
        return ()
    heights = ", ".join(f"{base * 1e3:.1f}" for base in floors)
    return (
        f"the tools swap on floors at {heights} mm, but the sheet springs off these heights once they are formed: "
        "without a springback correction the tools press from the wrong side until they meet the sheet",
    )


def check_floors(contours: Sequence[Contour], sides: Sequence[Side], job: Job) -> None:
    """The support tool of what stands on a floor has room between it and the wall that ends on that floor.

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL with the place
    """
    for number, side in enumerate(sides):
        held = holder(side, sides[:number])
        tool = job.tool_2 if side.forming_tool == 1 else job.tool_1
        if held is None or tool is None:
            continue
        around = sides[held[0]]
        # the support tool runs where the one that formed the floor ran, on the same face of the sheet
        face = np.array([0.0, 0.0, 0.0 if around.forming_tool == 1 else job.sheet.thickness])
        # what presses on the floor itself is a matter of the island's curvature: check_support
        floor = float(around.seen(np.array([0.0, 0.0, side.base]))[2])
        z = around.surface.z
        wall = replace(around.surface, z=np.where(z > floor + PRESSING_TOLERANCE, z, NOWHERE))
        mine = range(first_number(sides, number), first_number(sides, number + 1))
        for contour in contours:
            if contour.feature not in mine or not contour.has_support:
                continue
            tips = around.seen(contour.support_tip) - face
            cut = tip_surface.drop_tool(wall, tips[:, :2], tool.ball_radius)[0] - tips[:, 2]
            worst = int(np.argmax(cut))
            if cut[worst] > PRESSING_TOLERANCE:
                raise IsfError(
                    ErrorCode.PART_TOO_SMALL_FOR_TOOL,
                    f"between the island and the wall around its floor there is no room for the support tool of "
                    f"radius {tool.radius * 1e3:.2f} mm: it would press {cut[worst] * 1e3:.2f} mm into the wall",
                    where=f"{contour_label(contour.index)} at {place_text(contour.support_tip[worst])}",
                    advice="use a smaller support tool, widen the floor, or use path.islands: around",
                )


def check_support(contours: tuple[Contour, ...], sides: Sequence[Side], job: Job) -> tuple[str, ...]:
    """Warning where the support tool is too large for the curvature and presses beside its contact.

    The sheet is taken to be as thick beside the contact as at it. A flat tip is a ring of balls. Under the blank the
    tool stays on the line of a feature's first contour, which is the only one looked at then.
    """
    if job.process != "DSIF":
        return ()
    deepest, place, index, used = 0.0, np.zeros(3), 0, 0.0
    for number, side in enumerate(sides):
        tool = job.tool_2 if side.forming_tool == 1 else job.tool_1
        if tool is None:
            continue
        mine = range(first_number(sides, number), first_number(sides, number + 1))
        stride = tip_surface.STRIDE
        nodes = np.ascontiguousarray(side.surface.z[::stride, ::stride])
        features: set[int] = set()
        for contour in contours:
            known = contour.feature in features
            if contour.feature not in mine or (known and job.path.support == "on_blank"):
                continue
            features.add(contour.feature)
            centres, reach = _support_balls(contour, side, tool, job)
            pitch = stride * side.surface.pitch
            pressing = surface_kernels.ball_cut(nodes, side.surface.origin, pitch, centres, reach)
            worst = int(np.argmax(pressing))
            if pressing[worst] > deepest:
                deepest, index, used = float(pressing[worst]), contour.index, tool.radius
                place = contour.support_tip[worst % len(contour)]
    if deepest <= PRESSING_TOLERANCE:
        return ()
    return (
        f"{contour_label(index)} at {place_text(place)}: the support tool of radius {used * 1e3:.2f} mm is too large "
        f"for the curvature there and presses {deepest * 1e3:.2f} mm deeper beside its contact",
    )


def _support_balls(contour: Contour, side: Side, tool: ToolSpec, job: Job) -> tuple[Array, Array]:
    """Centres (M * N, 3) m of the balls a support tip consists of, in the view of the forming tool, and how near (m)
    the given surface may come to them; M is 1 for a ball."""
    tips = side.seen(contour.support_tip)
    bearing = np.arange(FLAT_BALLS if tool.flat_radius > 0 else 1) * 2 * np.pi / FLAT_BALLS
    around = tool.flat_radius * np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(len(bearing))])
    # a lower forming tool touches the other face, one blank's thickness beyond the given surface
    beyond = 0.0 if side.forming_tool == 1 else job.sheet.thickness
    centres = (tips + around[:, None, :] - np.array([0.0, 0.0, tool.ball_radius + beyond])).reshape(-1, 3)
    return centres, np.tile(tool.ball_radius + job.path.squeeze_factor * contour.thickness, len(bearing))


LEFT = 0.1e-3
"""m, depth of a pocket without a loop that is not worth a word."""


def check_pockets(mesh: Mesh, levels: Array, nodes: Sequence[RoughLoop], radius: float) -> None:
    """Refuse parts with a pocket that the tool does not get into.

    Parameters
    ----------
    mesh : placed part
    levels : (K,) m ; nodes : loops of the tip ; radius : m, of the tool

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL with the pocket's place and depth, CONTOUR_LOST where a section is not closed
    """
    by_level: dict[float, list[shapely.Polygon]] = {}
    for node in nodes:
        if node.real and not node.island:
            by_level.setdefault(round(node.level, 9), []).append(node.polygon)
    for level, loops in zip(levels[:-1], slice_mesh(mesh, levels[:-1]), strict=True):
        tips = by_level.get(round(float(level), 9), [])
        for loop in loops:
            if not loop.closed:
                raise IsfError(
                    ErrorCode.CONTOUR_LOST,
                    "the section of the part is not closed",
                    where=f"level {level * 1e3:.3f} mm at {place_text(loop.points[0])}",
                    advice="repair the mesh: part.repair: true",
                )
            if loop.area > 0 and not _held(loop, tips):
                _refuse_if_deep(mesh, loop, float(level), radius)


def _held(loop: MeshLoop, tips: Sequence[shapely.Polygon]) -> bool:
    """One of the loops of the tip lies inside the section."""
    if len(tips) == 0 or len(loop.points) < 3:
        return False
    shape = shapely.Polygon(loop.points)
    return any(shapely.contains_xy(shape, *tip.exterior.coords[0]) for tip in tips) or any(
        shapely.contains_xy(shape, *tip.representative_point().coords[0]) for tip in tips
    )


def _refuse_if_deep(mesh: Mesh, loop: MeshLoop, level: float, radius: float) -> None:
    if len(loop.points) < 3:
        return
    low, high = loop.points.min(axis=0), loop.points.max(axis=0)
    near = ((mesh.vertices[:, :2] >= low) & (mesh.vertices[:, :2] <= high)).all(axis=1)
    inside = mesh.vertices[near][shapely.contains_xy(shapely.Polygon(loop.points), mesh.vertices[near][:, :2])]
    if len(inside) == 0:
        return
    deepest = inside[np.argmin(inside[:, 2])]
    depth = level - float(deepest[2])
    if depth > LEFT:
        width = float((high - low).min())
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"a pocket {width * 1e3:.1f} mm wide at level {level * 1e3:.2f} mm and {depth * 1e3:.2f} mm deeper is "
            f"narrower than the tool of radius {radius * 1e3:.2f} mm",
            where=f"mesh at {place_text(deepest)}",
            advice="use a smaller tool, or widen the pocket",
        )
