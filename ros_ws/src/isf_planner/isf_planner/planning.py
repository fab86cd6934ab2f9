"""Planning a part: from the job file to contours, tool tips and the target surface.

The last step adds forces and limits along the contours, then the compensation that needs no feedback.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace

import numpy as np
from isf_core.contour import Contour
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.geometry.tool_axis import inclination
from isf_core.types import Array
from numpy.typing import NDArray

from isf_planner import replanning
from isf_planner.accuracy.moved_target import MovedTarget, compensated
from isf_planner.checks import arm_checks, part_checks
from isf_planner.checks.shank_checks import ShankClearance, check_shank
from isf_planner.forming.sides import merged
from isf_planner.forming.stages import Stage
from isf_planner.loops.sections import LoopTree
from isf_planner.part import mesh_checks, meshes
from isf_planner.part.meshes import Mesh
from isf_planner.paths import support_tool, tool_paths
from isf_planner.paths.five_axis import tilt_warning, with_tool_axis
from isf_planner.paths.partial_paths import PartialPaths
from isf_planner.predict.compensation import compensate
from isf_planner.predict.predictions import with_predictions
from isf_planner.processes import Cancelled, Progress, Steps, process_of
from isf_planner.replanning import PlanBase
from isf_planner.surface import target_surface


def finish(contours: tuple[Contour, ...], job_file: JobFile) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
    """Contours with predicted forces, compensated tips and the axis of a tilted tool, and warnings with their place."""
    filled, warnings = with_predictions(contours, job_file)
    moved, reported = compensate(filled, job_file)
    if not job_file.tilts:
        return moved, (*warnings, *reported)
    tilted = with_tool_axis(moved, job_file)
    return tilted, (*warnings, *reported, *tilt_warning(tilted, job_file))


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
    stages : shapes that the stages end with, the part last; none of a part formed in one stage
    partial : partial paths of all stages, side by side; none where the job does not ask for them
    tree : loops of the forming tool's tip with normals, curvatures and features, or None for a plan from a file
    base : what :func:`replan` needs for a change of tool, or None
    shank : where shank and holder of a tilted tool come nearest to anything; None with an upright one
    ball_radius : m, of the upper tool's tip; NaN where a plan file does not hold it
    moved : the target as the contours form it, where accuracy surfaces move it; ``target`` and ``mesh`` are the part
    """

    plan_id: str
    contours: tuple[Contour, ...]
    target: HeightMap
    mesh: tuple[Array, NDArray[np.int64]]
    warnings: tuple[str, ...]
    stages: tuple[Stage, ...] = field(default=(), repr=False, compare=False)
    partial: tuple[PartialPaths, ...] = field(default=(), repr=False, compare=False)
    tree: LoopTree | None = field(default=None, repr=False, compare=False)
    base: PlanBase | None = field(default=None, repr=False, compare=False)
    shank: ShankClearance | None = field(default=None, repr=False, compare=False)
    ball_radius: float = field(default=float("nan"), compare=False)
    moved: MovedTarget | None = field(default=None, repr=False, compare=False)

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
        """s, at the planned feed, slower where a tilted tool has to turn, without the moves between contours."""
        return sum(_time(contour) for contour in self.contours)

    @property
    def largest_tilt(self) -> float:
        """rad, of the forming tool; 0 where it is upright all along."""
        return max((float(inclination(c.forming_axis).max()) for c in self.contours if c.tilted), default=0.0)


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
    step = Steps(progress or (lambda phase, share: None), cancelled or (lambda: False))
    step("reading the mesh", 0.0)
    loaded, repaired = _load(job_file)
    warnings = list(repaired)
    process = process_of(job)
    moved = _moved(loaded, job_file, step) if job.part.accuracy_surfaces is not None else None
    part = process.prepare(moved.moved if moved else loaded, job_file, step)
    planned = list(part.sides)
    warnings += [*part.warnings, *(moved.warnings if moved else ())]
    if job.path.islands == "swap":
        part_checks.check_islands(planned)
        warnings += part_checks.left_by_springback(planned, job)
    part_warnings = tuple(warnings)
    step("tools", 0.9)
    plan_id = _identify(job_file)
    contours, reported = process.contours(part, job_file, plan_id)
    warnings += reported
    warnings += (*tool_paths.left_out(contours, job), *support_tool.rule_warnings(contours, planned, job_file))
    contours, expected = finish(contours, job_file)
    warnings += (*tool_paths.left_to_sine_law(planned, job), *expected)
    part_checks.check_travel(contours, rig)
    part_checks.check_axes(contours, rig, job.tool_1.ball_radius)
    if rig.kinematics == "arm":
        arm_checks.check_arms(contours, job, rig)
    part_checks.check_backing_plate(contours, job)
    last = tuple(contour for contour in contours if contour.stage == len(part.preforms))
    part_checks.check_floors(last, planned, job)
    warnings += part_checks.check_support(last, planned, job)
    nominal = moved.nominal if moved else part.mesh
    target = target_surface.target_map(nominal, rig.clamp.size)
    shank = check_shank(contours, target, job_file) if job_file.tilts else None
    step("done", 1.0)
    base = PlanBase(job, tuple(planned), part_warnings)
    unique = tuple(dict.fromkeys(warnings))
    mesh = nominal.vertices, nominal.faces
    partial = tuple(side.partial for side in (*part.preforms, *planned) if side.partial is not None)
    ball, tree = job.tool_1.ball_radius, merged(planned)
    return Plan(plan_id, contours, target, mesh, unique, part.stages, partial, tree, base, shank, ball, moved)


def replan(before: Plan, job_file: JobFile) -> Plan:
    """The plan of ``before`` for a job with other tools, sheet thickness, feed, paths or control, in milliseconds.

    Contacts, normals and curvatures are kept (:mod:`isf_planner.replanning`). Where the job changes what they depend
    on (part, levels, process, rig), or the process keeps none (TPIF, ADSIF), the part is planned anew.

    Raises
    ------
    IsfError : as :func:`plan`; PART_TOO_SMALL_FOR_TOOL where the new tool does not fit
    """
    base, job = before.base, job_file.job
    staged = before.stages or job.path.stages or job.path.morph
    partial = before.partial or job.path.partial_paths
    if base is None or staged or partial or before.moved or job.strategy:
        return plan(job_file)
    if not replanning.same_contacts(base.job, job):
        return plan(job_file)
    mesh = Mesh(*before.mesh)
    part_checks.check_fit(mesh_checks.PlacedPart(mesh, -float(mesh.vertices[:, 2].min()), ()), job, job_file.rig)
    sides = replanning.with_tools(base, job)
    plan_id = _identify(job_file)
    made = tool_paths.make_contours(list(sides), job_file, plan_id)
    ruled = support_tool.rule_warnings(made, sides, job_file)
    contours, expected = finish(made, job_file)
    part_checks.check_travel(contours, job_file.rig)
    part_checks.check_axes(contours, job_file.rig, job.tool_1.ball_radius)
    if job_file.rig.kinematics == "arm":
        arm_checks.check_arms(contours, job, job_file.rig)
    part_checks.check_backing_plate(contours, job)
    part_checks.check_floors(contours, sides, job)
    pressing = part_checks.check_support(contours, sides, job)
    shank = check_shank(contours, before.target, job_file) if job_file.tilts else None
    left = tool_paths.left_to_sine_law(sides, job)
    reported = tuple(dict.fromkeys((*base.reported, *ruled, *left, *expected, *pressing)))
    tree, ball = merged(sides), job.tool_1.ball_radius
    return replace(
        before, plan_id=plan_id, contours=contours, warnings=reported, tree=tree, shank=shank, ball_radius=ball
    )


def _load(job_file: JobFile) -> tuple[Mesh, tuple[str, ...]]:
    """The mesh of the job, upright and repaired, and what was repaired."""
    part, tool = job_file.job.part, job_file.job.tool_1.radius
    mesh = mesh_checks.oriented(meshes.load_mesh(job_file.mesh, part.unit), part.up, part.turn, part.scale)
    mesh_checks.check_size(mesh, job_file.rig.clamp.size, tool)  # distances of repairs mean nothing in a wrong unit
    return mesh_checks.repair(mesh, 2.0 * tool) if part.repair else (mesh, ())


def _moved(loaded: Mesh, job_file: JobFile, step: Steps) -> MovedTarget:
    """The part ``loaded``, placed, with its target moved by the accuracy surfaces of the job."""
    step("accuracy surfaces", 0.0)
    job, clamp = job_file.job, job_file.rig.clamp.size
    placed = mesh_checks.check_and_place(loaded, clamp, job.tool_1.radius, place=job.part.place)
    return compensated(placed.mesh, job_file)


def _identify(job_file: JobFile) -> str:
    surfaces = job_file.job.part.accuracy_surfaces
    learned = (job_file.base / surfaces).read_bytes() if surfaces is not None else b""
    digest = hashlib.sha256(job_file.text.encode() + job_file.mesh.read_bytes() + learned).hexdigest()
    return f"{job_file.job.name}-{digest[:8]}"


def _time(contour: Contour) -> float:
    """s along the contour."""
    if not (contour.tilted and len(contour.speed)):
        return _length(contour) / contour.feed
    order = np.arange(len(contour) + (1 if contour.closed else 0)) % len(contour)
    way = np.linalg.norm(np.diff(contour.forming_tip[order], axis=0), axis=1)
    slow = 1.0 / contour.speed[order]
    return float((0.5 * way * (slow[1:] + slow[:-1])).sum())


def _length(contour: Contour) -> float:
    closing = float(np.linalg.norm(contour.forming_tip[0] - contour.forming_tip[-1])) if contour.closed else 0.0
    return float(contour.arc_length()[-1]) + closing
