"""The backing plate of a part: whether anything meets it, whether something holds the sheet near the opening, and the
plate that would."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
import yaml
from isf_core.contour import Contour, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job
from isf_core.files.rig import Rig
from isf_core.files.tooling import BackingPlateSpec
from isf_core.process.free_sheet import SAG
from isf_core.types import Array, Indices

from isf_planner.checks.mesh_slicing import slice_mesh
from isf_planner.part.mesh_checks import place_text
from isf_planner.part.meshes import Mesh
from isf_planner.paths import support_tool

PLATE_TOLERANCE = 0.1e-3
"""m, by which the sheet may be pressed into a backing plate: against its edge it is, where the opening is that of the
part."""

PLATE_GAP = 0.9e-3
"""m at least between the first contour and the edge of a near backing plate (assumed): over ren_cone_plate 1 mm leave
0.82 / 0.28 mm of error, 2 mm 1.09 / 0.43, and none is corrected nearer than 0.1 mm (docs/results/index.md)."""

FREE_SHEET = 10e-3
"""m from the opening to what holds the sheet, beyond which it is warned of (assumed)."""

NEAR = 4e-3
"""m from the opening that a round or a rectangular plate may leave free, with which the opening sinks by 1.2 mm
(:mod:`isf_core.process.free_sheet`): beyond it a plate is cut along the part."""

THINNEST_LAND = 6e-3
"""m of plate between two openings; where there would be less they are cut as one (assumed)."""

CORNER_ROOM = 20e-6
"""m, by which the corners of an outline may lie beside the smooth line, outwards alone."""


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
                advice=f"give its opening {_tenths(most)} mm more on each side (backing_plate)",
            )
    index, missing, tip = _into_edge(contours, plate, job)
    if job.tool_2 is not None and (missing > 0.0).any():
        worst = int(np.argmax(missing))
        raise IsfError(
            ErrorCode.PART_DOES_NOT_FIT,
            f"the lower tool of radius {job.tool_2.radius * 1e3:.2f} mm would run {missing[worst] * 1e3:.2f} mm into "
            "the edge of the backing plate",
            where=f"{contour_label(index[worst])} at {place_text(tip[worst])}",
            advice=f"give its opening {_tenths(missing[worst])} mm more on each side (backing_plate), or form "
            "with one tool (process SPIF)",
        )


def _into_edge(contours: Sequence[Contour], plate: BackingPlateSpec, job: Job) -> tuple[Indices, Array, Array]:
    """(N,) contour, (N,) m by which the lower tool would run into the plate's edge, and (N, 3) m of its tips; nothing
    of one tool."""
    if job.tool_2 is None:
        return np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, 3))
    index, tip = _points(
        [
            (contour.index, contour.support_tip if contour.forming_tool == 1 else contour.forming_tip)
            for contour in contours
        ]
    )
    return index, job.tool_2.radius - plate.inside(tip[:, 0], tip[:, 1]), tip


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
    of_file = "" if nearer is None or nearer.shape != "outline" else ": backing_plate.yaml of isf plan"
    opening = "" if nearer is None else f" ({plate_text(nearer)}{of_file})"
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
    """The backing plate whose opening lies closest around all openings of the part, :data:`PLATE_GAP` away from the
    first contours at least, and nowhere under more than :data:`PLATE_TOLERANCE` of the part ``mesh``: a first contour
    of a large step lies deep inside the rounding of the opening.

    Round or rectangular in whole mm; cut along the part where such a plate would leave the sheet free beyond
    :data:`NEAR`, as one does whose opening lies off the middle of the clamp. None where the sheet is held within
    :data:`FREE_SHEET`, where no plate lies closer than what holds it, and where it leaves a lower tool no room even
    after it has waited.
    """
    free = free_sheet(contours, job, rig)
    if job.process not in ("SPIF", "DSIF") or free <= FREE_SHEET:
        return None
    places = _openings(contours)[:, :2]
    sections = [section.points for section in slice_mesh(mesh, np.array([-PLATE_TOLERANCE]))[0] if section.closed]
    reach = np.maximum(_reach(places) + PLATE_GAP, _reach(np.vstack([np.zeros((1, 2)), *sections])))
    across, along_x, along_y = (1e-3 * math.ceil(2e3 * half - 1e-6) for half in reach)
    plates = [  # of numbers that need no reading
        BackingPlateSpec.model_construct(shape="circle", size=(across, across)),
        BackingPlateSpec.model_construct(shape="rectangle", size=(along_x, along_y)),
    ]
    left, plate = min(((float(plate.inside(*places.T).max()), plate) for plate in plates), key=lambda pair: pair[0])
    if left > NEAR:
        plate = _along_part(contours, sections)
        left = float(plate.inside(*places.T).max())
    return plate if left < free and _leaves_room(contours, plate, job) else None


def _leaves_room(contours: Sequence[Contour], plate: BackingPlateSpec, job: Job) -> bool:
    """Whether the lower tool of a job, where there is one, gets past ``plate``, at the latest once it has waited."""
    over = job.model_copy(update={"backing_plate": plate})
    placed, _ = support_tool.waiting(contours, over)
    return not (_into_edge(placed, plate, job)[1] > 0.0).any()


def _along_part(contours: Sequence[Contour], sections: Sequence[Array]) -> BackingPlateSpec:
    """A plate cut along the part: around the first contours and the part's ``sections`` (N, 2) m."""
    firsts = [shapely.Polygon(loop[:, :2]).buffer(0.0).buffer(PLATE_GAP) for loop in _first_contacts(contours)]
    cut = shapely.union_all([*firsts, *(shapely.Polygon(section).buffer(0.0) for section in sections)])
    half = 0.5 * THINNEST_LAND
    whole = cut.buffer(half).buffer(-half).buffer(CORNER_ROOM).simplify(CORNER_ROOM)
    openings = [shape.exterior for shape in shapely.get_parts(whole)]
    corners = [np.round(shapely.get_coordinates(ring)[:-1], 5) for ring in openings]
    return BackingPlateSpec(
        shape="outline", openings=tuple(tuple((float(x), float(y)) for x, y in loop) for loop in corners)
    )


def _reach(places: Array) -> Array:
    """(3,) m, how far ``places`` (N, 2) lie from the middle of the clamp at most: any way, along x, along y."""
    return np.array([np.hypot(*places.T).max(), *np.abs(places).max(axis=0)])


def plate_fields(plate: BackingPlateSpec) -> dict[str, Any]:
    """Fields of ``plate`` as a job file has them."""
    if plate.size is not None:
        return {"shape": plate.shape, "size": [_mm(side) for side in plate.size]}
    loops = [[[_mm(value) for value in corner] for corner in loop] for loop in plate.openings]
    return {"shape": plate.shape, "openings": loops}


def plate_text(plate: BackingPlateSpec) -> str:
    """``plate`` for people: its fields in one line, or of one along an outline what it is."""
    if plate.size is not None:
        return f"{{shape: {plate.shape}, size: [{', '.join(map(_mm, plate.size))}]}}"
    number = len(plate.openings)
    return f"cut along the part, with {number} openings" if number > 1 else "cut along the part"


def plate_file(plate: BackingPlateSpec, name: str) -> str:
    """Text of a file for ``backing_plate`` of a job."""
    gap = f"assumed: isf plan, {_mm(PLATE_GAP)} around the first contours of {name}"
    fields = plate_fields(plate)
    told = {"name": f"{name}_plate", **fields, "provenance": dict.fromkeys(fields, gap)}
    return yaml.safe_dump(told, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)


def _mm(length: float) -> str:
    return f"{1e3 * length:.6g} mm"


def _first_contacts(contours: Sequence[Contour]) -> list[Array]:
    """(N, 3) m, contacts of the first contour of every feature that is an opening of the sheet: not of one that lies
    inside another one, as what stands on a floor does."""
    firsts: dict[int, Array] = {}
    for contour in contours:
        firsts.setdefault(contour.feature, contour.contact)
    found = list(firsts.values())
    if len(found) < 2:
        return found
    areas = [shapely.Polygon(loop[:, :2]).buffer(0.0) for loop in found]
    return [
        loop
        for k, loop in enumerate(found)
        if not any(area.area > areas[k].area and area.covers(areas[k].representative_point()) for area in areas)
    ]


def _openings(contours: Sequence[Contour]) -> Array:
    """(N, 3) m, contacts of all first contours."""
    return np.vstack([np.empty((0, 3)), *_first_contacts(contours)])


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
