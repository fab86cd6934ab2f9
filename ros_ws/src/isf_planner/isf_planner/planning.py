"""Planning a part: from the job file to contours, tool tips and the target surface.

The last step adds forces and limits along the contours, then the compensation that needs no feedback.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from numpy.typing import NDArray

from isf_planner import replanning
from isf_planner.checks import part_checks
from isf_planner.forming import stages
from isf_planner.forming.sides import UPSIDE_DOWN, HalfPart, Side, merged, parts, swapped
from isf_planner.loops import sections
from isf_planner.loops.sections import LoopTree
from isf_planner.part import mesh_checks, meshes
from isf_planner.part.meshes import Mesh
from isf_planner.part.warning_places import in_sheet
from isf_planner.paths import adsif_path, support_tool, tool_paths, tpif_path
from isf_planner.predict.compensation import compensate
from isf_planner.predict.predictions import with_predictions
from isf_planner.replanning import PlanBase
from isf_planner.surface import target_surface, tip_surface


def finish(contours: tuple[Contour, ...], job_file: JobFile) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
    """Contours with predicted forces and compensated tips, and warnings with their place."""
    filled, warnings = with_predictions(contours, job_file)
    moved, told = compensate(filled, job_file)
    return moved, (*warnings, *told)


Progress = Callable[[str, float], None]
Cancelled = Callable[[], bool]


@dataclass(frozen=True)
class Plan:
    """What is to be formed, and how.

    Attributes
    ----------
    plan_id : the same for the same job text and mesh
    contours : in the order of forming
    target : upper target surface over the clamp on a 1 mm grid, 0 beside the part
    mesh : vertices (V, 3) m in frame ``sheet`` and faces (F, 3) of the placed part
    warnings : what to look at before forming
    tree : loops of the forming tool's tip with normals, curvatures and features, or None for a plan from a file
    base : what :func:`replan` needs for a change of tool, or None
    """

    plan_id: str
    contours: tuple[Contour, ...]
    target: HeightMap
    mesh: tuple[Array, NDArray[np.int64]]
    warnings: tuple[str, ...]
    tree: LoopTree | None = field(default=None, repr=False, compare=False)
    base: PlanBase | None = field(default=None, repr=False, compare=False)

    @property
    def smallest_thickness(self) -> float:
        """m, thinnest predicted sheet."""
        return min(float(contour.thickness.min()) for contour in self.contours)

    @property
    def largest_wall_angle(self) -> float:
        """rad, at the contacts of the forming tool."""
        return max(float(contour.wall_angle.max()) for contour in self.contours)

    @property
    def path_length(self) -> float:
        """m, of the forming tip along all contours, without the moves between them."""
        return sum(_length(contour) for contour in self.contours)

    @property
    def forming_time(self) -> float:
        """s, at the planned feed, without the moves between contours."""
        return sum(_length(contour) / contour.feed for contour in self.contours)


def plan(job_file: JobFile, *, progress: Progress | None = None, cancelled: Cancelled | None = None) -> Plan:
    """Plan the part of a job.

    Parameters
    ----------
    job_file : the job with its rig, material and mesh path
    progress : called with a phase for people and the finished part 0..1
    cancelled : asked between the phases and levels

    Raises
    ------
    IsfError : codes 1101-1112 with the place and an advice; PLAN_CANCELLED
    """
    job, rig = job_file.job, job_file.rig
    step = _Steps(progress or (lambda phase, share: None), cancelled or (lambda: False))
    step("reading the mesh", 0.0)
    loaded, repaired = _load(job_file)
    warnings = list(repaired)
    tpif: tpif_path.TpifPart | None = None
    if job.process == "TPIF":
        tpif = tpif_path.plan_part(loaded, job_file, step)
        planned, mesh = [tpif.side], tpif.mesh
        warnings += tpif.warnings
    else:
        planned, shifts = [], []
        for part in _parts(loaded, job_file):
            side, shift, told = _plan_half(part, job_file, step)
            planned.append(side)
            shifts.append(shift)
            warnings += told
        mesh = loaded.moved(shifts[0])  # the height of an island's floor is known from the others
    if job.path.islands == "swap":
        part_checks.check_islands(planned)
        warnings += part_checks.left_by_springback(planned, job)
    preforms = [_plan_half(half, job_file, step)[0] for half in stages.preforms(loaded, planned, job)]

    told_of_part = tuple(warnings)
    step("tools", 0.9)
    plan_id = _identify(job_file)
    if tpif is not None:
        contours = tpif_path.make_contours(tpif, job_file, plan_id)
    elif job.process == "ADSIF":
        contours, flat = adsif_path.make_contours(planned[0].tree, planned[0].surface, job_file, plan_id)
        warnings += flat
    else:
        groups = [tool_paths.make_contours(sides, job_file, plan_id) for sides in (*([s] for s in preforms), planned)]
        contours = stages.joined(groups)
    warnings += (*tool_paths.left_out(contours, job), *support_tool.rule_warnings(contours, planned, job_file))
    contours, expected = finish(contours, job_file)
    warnings += (*tool_paths.left_to_sine_law(planned, job), *expected)
    part_checks.check_travel(contours, rig)
    last = tuple(contour for contour in contours if contour.stage == len(preforms))
    part_checks.check_floors(last, planned, job)
    warnings += part_checks.check_support(last, planned, job)
    target = target_surface.target_map(mesh, rig.clamp.size)
    step("done", 1.0)
    base = PlanBase(job, tuple(planned), told_of_part)
    unique = tuple(dict.fromkeys(warnings))
    return Plan(plan_id, contours, target, (mesh.vertices, mesh.faces), unique, merged(planned), base)


def replan(before: Plan, job_file: JobFile) -> Plan:
    """The plan of ``before`` for a job with other tools, sheet thickness, feed, paths or control, in milliseconds.

    Contacts, normals and curvatures are kept (:mod:`isf_planner.replanning`). Where the job changes what they depend
    on (part, levels, process, rig), or the process keeps none (TPIF, ADSIF), the part is planned anew.

    Raises
    ------
    IsfError : as :func:`plan`; PART_TOO_SMALL_FOR_TOOL where the new tool does not fit
    """
    base, job = before.base, job_file.job
    if base is None or job.path.stages or not replanning.same_contacts(base.job, job):
        return plan(job_file)
    mesh = Mesh(*before.mesh)
    part_checks.check_fit(mesh_checks.PlacedPart(mesh, -float(mesh.vertices[:, 2].min()), ()), job, job_file.rig)
    sides = replanning.with_tools(base, job)
    plan_id = _identify(job_file)
    made = tool_paths.make_contours(list(sides), job_file, plan_id)
    ruled = support_tool.rule_warnings(made, sides, job_file)
    contours, expected = finish(made, job_file)
    part_checks.check_travel(contours, job_file.rig)
    part_checks.check_floors(contours, sides, job)
    pressing = part_checks.check_support(contours, sides, job)
    left = tool_paths.left_to_sine_law(sides, job)
    told = tuple(dict.fromkeys((*base.told, *ruled, *left, *expected, *pressing)))
    return replace(before, plan_id=plan_id, contours=contours, warnings=told, tree=merged(sides))


def _load(job_file: JobFile) -> tuple[Mesh, tuple[str, ...]]:
    """The mesh of the job, upright and repaired, and what was repaired."""
    part, tool = job_file.job.part, job_file.job.tool_1.radius
    mesh = mesh_checks.oriented(meshes.load_mesh(job_file.mesh, part.unit), part.up, part.turn, part.scale)
    mesh_checks.check_size(mesh, job_file.rig.clamp.size, tool)  # distances of repairs mean nothing in a wrong unit
    return mesh_checks.repair(mesh, 2.0 * tool) if part.repair else (mesh, ())


def _parts(mesh: Mesh, job_file: JobFile) -> list[HalfPart]:
    """What each tool forms; one tool forms everything alone."""
    if job_file.job.process != "DSIF":
        return [HalfPart(mesh, 1)]
    return parts(mesh, swap_islands=job_file.job.path.islands == "swap")


def _plan_half(half: HalfPart, job_file: JobFile, step: _Steps) -> tuple[Side, Array, list[str]]:
    """Loops of what one tool forms, in the view of that tool; the shift (3,) m of the mesh in frame ``sheet``.

    What is told, also by an error, names places in frame ``sheet``.
    """
    try:
        side, shift, warnings = _plan_view(half, job_file, step)
    except IsfError as error:
        what, where = (in_sheet(text, half.forming_tool, half.base) for text in (error.what, error.where))
        raise IsfError(error.code, what, where=where, advice=error.advice) from error
    upright = shift * (UPSIDE_DOWN if half.forming_tool == 2 else 1.0)
    return side, upright, [in_sheet(text, half.forming_tool, half.base) for text in warnings]


def _plan_view(half: HalfPart, job_file: JobFile, step: _Steps) -> tuple[Side, Array, list[str]]:
    job, rig = swapped(job_file.job, half.forming_tool), job_file.rig
    radius = job.tool_1.ball_radius
    part = mesh_checks.check_and_place(half.mesh, rig.clamp.size, job.tool_1.radius, place=job.part.place)
    part_checks.check_fit(part, job, rig)
    if job.process == "ADSIF":
        adsif_path.check_reachable(part.mesh, adsif_path.surface_for(job_file))
    limit = job.wall_angle_limit or job_file.material.max_wall_angle
    moved = part.warnings if half.base == 0.0 else ()  # told once, with the height of the flange
    warnings = list(moved + part_checks.check_wall_angle(part.mesh, limit))

    step("sampling the surface", 0.05)
    surface = target_surface.fine_surface(part.mesh, radius)
    step("dropping the tool", 0.3)
    x, y, height = tip_surface.tip_grid(surface, radius)
    warnings += part_checks.check_reach(surface, height, part.depth, radius)

    grid = sections.TipGrid(x, y, height, part.depth)
    levels = sections.levels(grid, surface, job)
    nodes, told = sections.trace(grid, levels, job)
    warnings += told
    part_checks.check_pockets(part.mesh, levels, nodes, radius)
    tree = sections.settle_all(nodes, surface, job, lambda k, n: step(f"contour {k + 1} of {n}", 0.4 + 0.5 * k / n))
    shift = part.mesh.vertices.min(axis=0) - half.mesh.vertices.min(axis=0)
    return Side(tree, surface, half.forming_tool, half.base), shift, warnings


def _identify(job_file: JobFile) -> str:
    digest = hashlib.sha256(job_file.text.encode() + job_file.mesh.read_bytes()).hexdigest()
    return f"{job_file.job.name}-{digest[:8]}"


def _length(contour: Contour) -> float:
    closing = float(np.linalg.norm(contour.forming_tip[0] - contour.forming_tip[-1])) if contour.closed else 0.0
    return float(contour.arc_length()[-1]) + closing


@dataclass(frozen=True)
class _Steps:
    """Tells the progress and stops when the plan is cancelled."""

    progress: Progress
    cancelled: Cancelled

    def __call__(self, phase: str, share: float) -> None:
        if self.cancelled():
            raise IsfError(ErrorCode.PLAN_CANCELLED, "planning was cancelled", where=phase)
        self.progress(phase, share)
