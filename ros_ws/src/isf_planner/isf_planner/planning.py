"""Planning a part: from the job file to contours, tool tips and the target surface."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.height_map import HeightMap
from isf_core.job import JobFile
from numpy.typing import NDArray

from isf_planner import (
    mesh_checks,
    mesh_input,
    part_checks,
    sections,
    slicing,
    target_surface,
    tip_surface,
    tool_paths,
)
from isf_planner.feature_tree import LoopTree

Array = NDArray[np.float64]

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
    """

    plan_id: str
    contours: tuple[Contour, ...]
    target: HeightMap
    mesh: tuple[Array, NDArray[np.int64]]
    warnings: tuple[str, ...]
    tree: LoopTree | None = field(default=None, repr=False, compare=False)

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
    if job.process not in ("SPIF", "DSIF"):
        raise IsfError(
            ErrorCode.PROCESS_NOT_SUPPORTED,
            f"process {job.process} cannot be planned yet",
            where="process",
            advice="use SPIF (one tool) or DSIF (two tools)",
        )
    step = _Steps(progress or (lambda phase, share: None), cancelled or (lambda: False))
    radius = job.tool_1.radius

    step("reading the mesh", 0.0)
    loaded = mesh_input.load_mesh(job_file.mesh, job.part.unit)
    part = mesh_checks.check_and_place(loaded, rig.clamp.size, radius)
    part_checks.check_fit(part, job, rig)
    limit = job.wall_angle_limit or job_file.material.max_wall_angle
    warnings = list(part.warnings + part_checks.check_wall_angle(part.mesh, limit))

    step("sampling the surface", 0.05)
    surface = target_surface.fine_surface(part.mesh, radius)
    step("dropping the tool", 0.3)
    x, y, height = tip_surface.tip_grid(surface, radius)
    warnings += part_checks.check_reach(surface, height, part.depth, radius)

    levels = slicing.levels(part.depth, job.path.incremental_depth)
    nodes, told = sections.trace(sections.TipGrid(x, y, height, part.depth), levels, job)
    warnings += told
    tree = sections.settle_all(nodes, surface, job, lambda k, n: step(f"contour {k + 1} of {n}", 0.4 + 0.5 * k / n))

    step("tools", 0.9)
    plan_id = _identify(job_file)
    contours = tool_paths.make_contours(tree, surface, job_file, plan_id)
    part_checks.check_travel(contours, rig)
    warnings += part_checks.check_support(contours, surface, job)
    target = target_surface.target_map(part.mesh, rig.clamp.size)
    step("done", 1.0)
    return Plan(plan_id, contours, target, (part.mesh.vertices, part.mesh.faces), tuple(warnings), tree)


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
