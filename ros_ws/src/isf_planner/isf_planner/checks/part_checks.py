"""Can this part be formed on this rig with these tools? Size, wall angle, fillets, tool travel, narrow pockets.

Pockets: where the tip may be at a level lies within what of the part is below the level. So every section of the mesh
around lower ground holds a loop of the tip at that level, or the pocket is too narrow for the tool there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job
from isf_core.files.rig import Rig
from isf_core.files.tooling import BackingPlateSpec, ToolSpec
from isf_core.geometry.tool_axis import point_on_axis, tilt_of
from isf_core.types import Array, Indices

from isf_planner.checks import arm_checks, leg_checks
from isf_planner.checks.mesh_slicing import MeshLoop, slice_mesh
from isf_planner.forming.sides import Side, first_number, holder
from isf_planner.loops.sections import RoughLoop
from isf_planner.part import mesh_kernels
from isf_planner.part.mesh_checks import PlacedPart, place_text
from isf_planner.part.meshes import Mesh
from isf_planner.surface import surface_kernels, tip_surface
from isf_planner.surface.target_surface import TargetSurface

ANGLE_MARGIN = 0.95
"""Wall angles above this part of the limit are warned of."""

SMALLEST_FACET = 1e-10
"""m^2; the normal of a smaller facet says nothing about the wall."""

UNREACHED_TOLERANCE = 0.1e-3
"""m, material left by the tool in a fillet before it is worth a warning."""

REACH_TOLERANCE = 20e-6
"""m, by which the tool may miss the deepest point."""

PRESSING_TOLERANCE = 0.1e-3
"""m, by which the support tool may press beside its contact before it is worth a warning."""

PLATE_TOLERANCE = 0.1e-3
"""m, by which the sheet may be pressed into a backing plate: against its edge it is, where the opening is that of the
part."""

PLATE_GAP = 0.9e-3
"""m at least between the first contour and the edge of a near backing plate (assumed): over ren_cone_plate 1 mm leave
0.82 / 0.28 mm of error, 2 mm 1.09 / 0.43, and none is corrected nearer than 0.1 mm (docs/results/index.md)."""

FREE_SHEET = 10e-3
"""m from the opening to what holds the sheet, beyond which it is warned of (assumed)."""

SAG = 0.6e-3
"""m by which the opening sinks, over the root of the mm of free sheet around it (14 parts of 1 mm of aluminium under
one tool on the elasto-plastic sheet within a factor of 1.4; scanned cones 0.7 to 1.3 mm: docs/methods/planning.md)."""

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


def check_wall_angle(mesh: Mesh, limit: float) -> tuple[str, ...]:
    """Warnings for walls near ``limit`` (rad); IsfError WALL_TOO_STEEP beyond it."""
    angle, worst = mesh_kernels.steepest(mesh.vertices, mesh.faces, SMALLEST_FACET)
    where = place_text(mesh.vertices[mesh.faces[worst]].mean(axis=0))
    steepest, most = np.degrees(angle), np.degrees(limit)
    if angle > limit:
        raise IsfError(
            ErrorCode.WALL_TOO_STEEP,
            f"the wall is {steepest:.1f} deg steep, {most:.1f} deg may be planned",
            where=f"mesh at {where}",
            advice="make the wall flatter, or set wall_angle_limit to try it: the sheet may tear",
        )
    if angle > ANGLE_MARGIN * limit:
        return (f"the wall at {where} is {steepest:.1f} deg steep, close to the limit of {most:.1f} deg",)
    return ()


def check_reach(surface: TargetSurface, tip_height: Array, depth: float, radius: float) -> tuple[str, ...]:
    """Warnings where the tool leaves material; IsfError PART_TOO_SMALL_FOR_TOOL when it cannot reach the bottom.

    ``tip_height`` as from :func:`isf_planner.surface.tip_surface.tip_grid`; ``depth`` and ``radius`` in m.
    """
    row, column = np.unravel_index(int(np.argmin(surface.z)), surface.z.shape)
    deepest = np.array([surface.x[column], surface.y[row]])
    missing = tip_surface.lowest_tip(surface, tip_height, radius) + depth
    if missing > REACH_TOLERANCE:
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"the tool of radius {radius * 1e3:.2f} mm stops {missing * 1e3:.2f} mm above the deepest point",
            where=f"mesh at {place_text(np.append(deepest, -depth))}",
            advice="use a smaller tool, or a larger radius or floor in the part",
        )
    left, place = tip_surface.unreached(surface, tip_height, radius, UNREACHED_TOLERANCE)
    if left <= UNREACHED_TOLERANCE:
        return ()
    return (
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


def check_backing_plate(contours: Sequence[Contour], job: Job) -> None:
    """Neither the formed sheet, nor the upper tool with the sheet around it, nor the lower tool meets the backing
    plate, whose opening has upright walls.

    Raises
    ------
    IsfError : PART_DOES_NOT_FIT with the worst place and by how much
    """
    plate = job.backing_plate
    if plate is None:
        return
    upper = [contour for contour in contours if contour.forming_tool == 1]
    index, contact = _points([(contour.index, contour.contact) for contour in upper])
    beyond = -plate.inside(contact[:, 0], contact[:, 1])
    cut = plate.height(contact[:, 0], contact[:, 1]) - contact[:, 2]
    pressed, missing = _tool_over_plate(upper, contact, plate, job)
    for into, wider, what in (
        (cut, beyond, "the part is formed {:.2f} mm into the backing plate"),
        (
            pressed,
            missing,
            f"the upper tool of radius {job.tool_1.radius * 1e3:.2f} mm presses the sheet {{:.2f}} mm into the edge of "
            "the backing plate",
        ),
    ):
        if (into > PLATE_TOLERANCE).any():
            worst = int(np.argmax(into))
            most = max(wider[into > PLATE_TOLERANCE].max(), missing.max())
            raise IsfError(
                ErrorCode.PART_DOES_NOT_FIT,
                what.format(into[worst] * 1e3),
                where=f"{contour_label(index[worst])} at {place_text(contact[worst])}",
                advice=f"give its opening {_tenths(most)} mm more on each side (backing_plate.size)",
            )
    if job.tool_2 is None:
        return
    index, tip = _points(
        [
            (contour.index, contour.support_tip if contour.forming_tool == 1 else contour.forming_tip)
            for contour in contours
        ]
    )
    missing = job.tool_2.radius - plate.inside(tip[:, 0], tip[:, 1])
    if (missing > 0.0).any():
        worst = int(np.argmax(missing))
        raise IsfError(
            ErrorCode.PART_DOES_NOT_FIT,
            f"the lower tool of radius {job.tool_2.radius * 1e3:.2f} mm would run {missing[worst] * 1e3:.2f} mm into "
            "the edge of the backing plate",
            where=f"{contour_label(index[worst])} at {place_text(tip[worst])}",
            advice=f"give its opening {_tenths(missing[worst])} mm more on each side (backing_plate.size), or form "
            "with one tool (process SPIF)",
        )


def check_held(contours: Sequence[Contour], mesh: Mesh, job: Job, rig: Rig) -> tuple[str, ...]:
    """Warning where nothing holds the sheet close to the part ``mesh``: it bends for good there, corrected or not."""
    if job.process not in ("SPIF", "DSIF") or job.path.support == "on_blank":
        return ()
    free = free_sheet(contours, job, rig)
    if free <= FREE_SHEET:
        return ()
    holds, remedy = ("clamp", "put") if job.backing_plate is None else ("backing plate", "bring")
    or_else = ", or keep the support tool under the blank (path.support: on_blank)" if job.process == "DSIF" else ""
    nearer = nearer_plate(contours, mesh, job, rig)
    opening = "" if nearer is None else f" ({plate_text(nearer)})"
    return (
        f"the sheet is free for {1e3 * free:.0f} mm between the part and the {holds}: it bends there for good while "
        f"the part is formed, and the opening sinks by about {1e3 * SAG * np.sqrt(1e3 * free):.1f} mm with any "
        "correction (1 mm of aluminium; less where the part is shallow or a second tool supports it); "
        f"{remedy} a backing_plate closer to the opening{opening}{or_else}, and see what is left with --sheet "
        "shell_coarse",
    )


def free_sheet(contours: Sequence[Contour], job: Job, rig: Rig) -> float:
    """m, from the place of an opening, the first contour of a feature, that is farthest from what holds the sheet."""
    x, y, _ = _openings(contours).T
    plate = job.backing_plate
    clamp = np.minimum(0.5 * rig.clamp.size[0] - np.abs(x), 0.5 * rig.clamp.size[1] - np.abs(y))
    return float((clamp if plate is None else plate.inside(x, y)).max(initial=0.0))


def nearer_plate(contours: Sequence[Contour], mesh: Mesh, job: Job, rig: Rig) -> BackingPlateSpec | None:
    """The backing plate, round or rectangular, whose opening in whole mm lies closest around all openings of the part,
    :data:`PLATE_GAP` away from the first contours at least, and nowhere under more than :data:`PLATE_TOLERANCE` of the
    part ``mesh``: a first contour of a large step lies deep inside the rounding of the opening.

    None where the sheet is held within :data:`FREE_SHEET`, where such a plate lies no closer than what holds it, and
    for two tools: the lower one would have to get between the part and the plate.
    """
    free = free_sheet(contours, job, rig)
    if job.process != "SPIF" or free <= FREE_SHEET:
        return None
    places = _openings(contours)[:, :2]
    (sections,) = slice_mesh(mesh, np.array([-PLATE_TOLERANCE]))
    edges = np.vstack([np.zeros((1, 2)), *(section.points for section in sections)])
    reach = np.maximum(_reach(places) + PLATE_GAP, _reach(edges))
    across, along_x, along_y = (1e-3 * math.ceil(2e3 * half - 1e-6) for half in reach)
    plates = (
        BackingPlateSpec(shape="circle", size=(across, across)),
        BackingPlateSpec(shape="rectangle", size=(along_x, along_y)),
    )
    left, plate = min(((float(plate.inside(*places.T).max()), plate) for plate in plates), key=lambda pair: pair[0])
    return plate if left < free else None


def _reach(places: Array) -> Array:
    """(3,) m, how far ``places`` (N, 2) lie from the middle of the clamp at most: any way, along x, along y."""
    return np.array([np.hypot(*places.T).max(), *np.abs(places).max(axis=0)])


def plate_text(plate: BackingPlateSpec) -> str:
    """Fields of ``plate`` as a job file has them."""
    x, y = (f"{1e3 * side:g} mm" for side in plate.size)
    return f"{{shape: {plate.shape}, size: [{x}, {y}]}}"


def _openings(contours: Sequence[Contour]) -> Array:
    """(N, 3) m, contacts of the first contour of every feature."""
    openings: dict[int, Array] = {}
    for contour in contours:
        openings.setdefault(contour.feature, contour.contact)
    return np.vstack([np.empty((0, 3)), *openings.values()])


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


def _tool_over_plate(
    contours: Sequence[Contour], contact: Array, plate: BackingPlateSpec, job: Job
) -> tuple[Array, Array]:
    """(N,) m, how far the sheet around the ball of the upper tool is pressed into the plate's rounded edge at each
    ``contact`` (N, 3) m of ``contours``; and by how much the opening is too small there, on each side.

    The plate's flat lies a sheet's thickness below z = 0. Its edge is a quarter circle, so the plate is what lies
    within its edge radius of a body with a sharp edge, from which the ball's centre has a distance across and above.
    """
    normal = np.vstack([np.empty((0, 3)), *(contour.normal for contour in contours)])
    formed = np.concatenate([np.empty(0), *(contour.thickness for contour in contours)])
    centre = contact + job.tool_1.ball_radius * normal
    across = plate.inside(centre[:, 0], centre[:, 1]) + plate.edge_radius
    above = centre[:, 2] + job.sheet.thickness + plate.edge_radius
    reach = job.tool_1.ball_radius + formed + plate.edge_radius
    off = np.hypot(np.maximum(across, 0.0), np.maximum(above, 0.0))
    distance = np.where((across > 0.0) | (above > 0.0), off, np.maximum(across, above))
    room = np.sqrt(np.maximum(reach**2 - np.maximum(above, 0.0) ** 2, 0.0))
    return reach - distance, room - across


def _tenths(length: float) -> str:
    """``length`` m in mm, rounded up."""
    return f"{np.ceil(length * 1e4) / 10.0:.1f}"


def _points(paths: Sequence[tuple[int, Array]]) -> tuple[Indices, Array]:
    """(N,) contour of each point and (N, 3) m of all ``paths``."""
    index = np.repeat([number for number, _ in paths], [len(path) for _, path in paths])
    return index.astype(np.int64), np.vstack([np.empty((0, 3)), *(path for _, path in paths)])


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
