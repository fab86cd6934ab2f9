"""Processes: how a part becomes contours. They are found by name as entry points, so that a cell adds its own.

A package registers a process in its ``setup.py``::

    entry_points={"isf.processes": ["MY_PROCESS = my_package.my_module:MyProcess"]}

where ``MyProcess`` derives from :class:`FormingProcess` or one of the processes here. Its name then stands in a job as
``process: MY_PROCESS``; machine, force control and simulated sheet treat its contours as those of its ``kind``.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import AdsifSpec, Job, JobFile, floor_step, load_process
from isf_core.files.rig import Rig
from isf_core.files.yaml_file import find_named
from isf_core.types import Array

from isf_planner.checks import part_checks
from isf_planner.features.segmentation import find_features
from isf_planner.features.surface_features import FeatureMap
from isf_planner.forming import stages
from isf_planner.forming.sides import UPSIDE_DOWN, HalfPart, Side, parts, swapped
from isf_planner.loops import level_spacing, sections, tip_loops
from isf_planner.loops.feature_levels import feature_levels
from isf_planner.part import mesh_checks
from isf_planner.part.meshes import Mesh
from isf_planner.part.warning_places import in_sheet
from isf_planner.paths import adsif_path, sequencing, tool_paths, tpif_path
from isf_planner.paths.partial_paths import partial_paths, without_path
from isf_planner.surface import target_surface, tip_surface

Progress = Callable[[str, float], None]
Cancelled = Callable[[], bool]

OF_NO_PATH: dict[str, Any] = {"model": True, "natural_frequency": True, "joints": {"__all__": {"stiffness"}}}
"""Of an arm: how it gives way is drawn, and decides nothing."""
OF_RIG: dict[str, Any] = {
    "clamp": {"size", "height"},
    "tool_1": {"arm"},
    "tool_2": {"arm"},
    "kinematics": True,
    "hexapod": True,
    "legs": {
        "valve": {"flow", "pressure_drop", "edge_ratio", "leakage"},
        "cylinder": {"bore", "rod"},
        "supply": {"flow", "pressure"},
    },
    "limits": {"travel"},
}
"""What planning reads of a rig: geometry, and what the checks refuse by. Forces only warn, park height and speed tell
the time alone."""
OF_MATERIAL = {
    "name",
    "young_modulus",
    "poisson_ratio",
    "yield_strength",
    "tensile_strength",
    "max_wall_angle",
    "strength_coefficient",
    "hardening_exponent",
    "pre_strain",
    "saturation_stress",
    "saturation_strain",
    "flow_curve",
}
"""What planning reads of a material: for predicted force, compensation of the sheet, chips and the largest angle."""


@dataclass(frozen=True)
class PreparedPart:
    """A part with the loops of its tools, before there are contours.

    Attributes
    ----------
    mesh : placed in frame ``sheet``
    sides : loops, features and sampled target as the forming tool of each side sees them
    preforms : the same of the stages before the last one
    warnings : what to look at
    over_die : what is planned over a die, None without one
    stages : shapes that the stages end with, the part last; none of a part formed in one stage
    """

    mesh: Mesh
    sides: tuple[Side, ...]
    preforms: tuple[Side, ...] = ()
    warnings: tuple[str, ...] = ()
    over_die: tpif_path.TpifPart | None = None
    stages: tuple[stages.Stage, ...] = ()


class FormingProcess(ABC):
    """How a part becomes contours."""

    kind: ClassVar[str] = "SPIF"
    """SPIF, DSIF, TPIF or ADSIF: what the contours are to machine, force control and simulated sheet."""

    def prepare(self, loaded: Mesh, job_file: JobFile, step: Steps) -> PreparedPart:
        """Loops of the part ``loaded`` of a job.

        Raises
        ------
        IsfError : codes 1101-1112 with the place and an advice; PLAN_CANCELLED
        """
        path = job_file.job.path
        own = step.part(0.0, 0.4 if path.stages or path.morph else 1.0)
        sides, shifts, warnings = [], [], []
        halves = _parts(loaded, job_file)
        for half in halves:
            side, shift, reported = _plan_half(half, job_file, own, alone=len(halves) == 1)
            sides.append(side)
            shifts.append(shift)
            warnings += reported
        mesh = loaded.moved(shifts[0])  # the height of an island's floor is known from the others
        made = stages.preforms(mesh, [side.forming_tool for side in sides], job_file, step.part(0.4, 0.5))
        begins = np.linspace(0.5, 0.9, len(made.parts) + 1)
        of_part = sides[0].partial.found if sides[0].partial else None
        preforms = tuple(
            _plan_preform(
                half, job_file, step.part(float(begin), float(end)), of_part, f"stage {k} of {len(made.stages)}"
            )
            for k, (half, (begin, end)) in enumerate(zip(made.parts, pairwise(begins), strict=True), 1)
        )
        return PreparedPart(mesh, tuple(sides), preforms, (*warnings, *made.warnings), stages=made.stages)

    @abstractmethod
    def contours(
        self, part: PreparedPart, job_file: JobFile, plan_id: str
    ) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
        """Contours in the order of forming, and warnings; raises IsfError as :meth:`prepare`."""


class IncrementalForming(FormingProcess):
    """SPIF: loop by loop from the opening to the floor."""

    def contours(
        self, part: PreparedPart, job_file: JobFile, plan_id: str
    ) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
        """As the base class."""
        make = sequencing.make_contours if job_file.job.path.partial_paths else tool_paths.make_contours
        groups = [make([side], job_file, plan_id, preform=True) for side in part.preforms]
        groups.append(make(list(part.sides), job_file, plan_id))
        return stages.joined([*groups, *[groups[-1]] * job_file.job.path.finishing_passes]), ()


class DoubleSidedForming(IncrementalForming):
    """DSIF: the same with a second tool on the other face; what rises above the blank it may form itself."""

    kind = "DSIF"


class FormingOverDie(FormingProcess):
    """TPIF: from the top of the part outwards over a die, the blank holder travelling down."""

    kind = "TPIF"

    def prepare(self, loaded: Mesh, job_file: JobFile, step: Steps) -> PreparedPart:
        """As the base class; DIE_COLLISION too."""
        part = tpif_path.plan_part(loaded, job_file, step)
        return PreparedPart(part.mesh, (part.side,), warnings=part.warnings, over_die=part)

    def contours(
        self, part: PreparedPart, job_file: JobFile, plan_id: str
    ) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
        """As the base class."""
        assert part.over_die is not None  # made by prepare
        return tpif_path.make_contours(part.over_die, job_file, plan_id), ()


class AccumulativeForming(FormingProcess):
    """ADSIF: both tools at one depth from the centre outwards; the part sinks."""

    kind = "ADSIF"

    def contours(
        self, part: PreparedPart, job_file: JobFile, plan_id: str
    ) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
        """As the base class."""
        side = part.sides[0]
        return adsif_path.make_contours(side.tree, side.surface, job_file, plan_id)


def process_of(job: Job) -> FormingProcess:
    """The process of a job; raises IsfError FILE_FIELD when it cannot be loaded or is none."""
    name = job.strategy or job.process
    found = load_process(name)()
    if isinstance(found, FormingProcess):
        return found
    raise IsfError(
        ErrorCode.FILE_FIELD,
        f"the process {name} is a {type(found).__name__}",
        where="process",
        advice="a process derives from isf_planner.processes.FormingProcess",
    )


def numbered(contours: Sequence[Contour]) -> tuple[Contour, ...]:
    """``contours`` with their index and count in this order."""
    return tuple(replace(contour, index=k, count=len(contours)) for k, contour in enumerate(contours))


def plan_id(job_file: JobFile, path: bytes | None = None) -> str:
    """Name of the job, and a digest of what contours follow from.

    A part goes on, and a contour is taken, only under the name of its plan: so the files that planning reads are in it
    by content, not by place, and it is the same in another copy of the folder. Of rig and material it holds what
    planning reads (:data:`OF_RIG`, :data:`OF_MATERIAL`): with a load cell that was calibrated anew the plan is the
    same, and with the force that is raised for a simulated sheet that is too strong. Files that only a correction reads
    (``springback.learning``, ``elastic.database``) are in it by their name in the job alone, and what else a process of
    another package reads is not.

    Parameters
    ----------
    path : of a program as it was read with its set-up, in place of the files that a path is planned from

    Raises
    ------
    IsfError : FILE_NOT_FOUND for a response surface; of other files that are missing their readers tell
    """
    job = job_file.job
    digest = hashlib.sha256(_text(job_file).encode())
    digest.update(json.dumps(_of_rig(job_file.rig, job), sort_keys=True).encode())
    digest.update(job_file.material.model_dump_json(include=OF_MATERIAL).encode())
    digest.update(path or b"")
    if job.path.floor_step == "auto":  # not in the job's text
        digest.update(f"{floor_step(job) or ''}".encode())
    named = (job.accuracy_surfaces, job.die.mesh if job.die else None, job.path.machine_error)
    files = [*job_file.sources, *(job_file.base / name for name in named if name is not None)]
    if job.process == "ADSIF":
        files.append(find_named("adsif", (job.adsif or AdsifSpec()).surface, job_file.base))
    for file in files if path is None else ():
        digest.update(file.read_bytes() if file.is_file() else b"")
    return f"{job.name}-{digest.hexdigest()[:8]}"


def _text(job_file: JobFile) -> str:
    """The job; the material of a blank that it names as a file stands in it with the folder, which is left out."""
    material = Path(job_file.job.sheet.material)
    return job_file.text.replace(str(material), material.name) if material.is_absolute() else job_file.text


def _of_rig(rig: Rig, job: Job) -> dict[str, Any]:
    arms = {"arm": OF_NO_PATH}
    read = rig.model_dump(mode="json", include=OF_RIG, exclude={"tool_1": arms, "tool_2": arms})
    if window := job.support_window:  # of contact stiffness and offset limit: support forces that the job leaves open
        read["support_window"] = [window.keeping, window.chips, window.reach]
    if job.process == "ADSIF" and (job.adsif or AdsifSpec()).compensate_compliance:
        read["give"] = [rig.tool_1.compliance[0], rig.tool_2.compliance[0]]
    return read


def _parts(mesh: Mesh, job_file: JobFile) -> list[HalfPart]:
    """What each tool forms; one tool forms everything alone."""
    if job_file.job.process != "DSIF":
        return [HalfPart(mesh, 1)]
    return parts(mesh, swap_islands=job_file.job.path.islands == "swap")


def _plan_preform(half: HalfPart, job_file: JobFile, step: Steps, of_part: FeatureMap | None, stage: str) -> Side:
    """Loops of a shape before the part; an error names the ``stage``, as its place is none of the part's own.

    ``of_part``: features of the part that the shape becomes; they are its own, too, at common levels.
    """
    try:
        return _plan_half(half, job_file, step, of_part, preform=True)[0]
    except IsfError as error:
        if error.code == ErrorCode.PLAN_CANCELLED:
            raise
        option = "path.morph" if job_file.job.path.morph else "path.stages"
        what, advice = f"{stage}, a shape before the part: {error.what}", f"change {option}, or {error.advice}"
        raise IsfError(error.code, what, where=error.where, advice=advice) from error


def _plan_half(
    half: HalfPart,
    job_file: JobFile,
    step: Steps,
    of_part: FeatureMap | None = None,
    *,
    preform: bool = False,
    alone: bool = True,
) -> tuple[Side, Array, list[str]]:
    """Loops of what one tool forms, in the view of that tool; the shift (3,) m of the mesh in frame ``sheet``.

    ``of_part``, a ``preform`` and ``alone`` as in :func:`_plan_view`.

    What is told, also by an error, names places in frame ``sheet``.
    """
    try:
        side, shift, warnings = _plan_view(half, job_file, step, of_part, preform=preform, alone=alone)
    except IsfError as error:
        what, where = (in_sheet(text, half.forming_tool, half.base) for text in (error.what, error.where))
        raise IsfError(error.code, what, where=where, advice=error.advice) from error
    upright = shift * (UPSIDE_DOWN if half.forming_tool == 2 else 1.0)
    return side, upright, [in_sheet(text, half.forming_tool, half.base) for text in warnings]


def _plan_view(
    half: HalfPart, job_file: JobFile, step: Steps, of_part: FeatureMap | None, *, preform: bool, alone: bool
) -> tuple[Side, Array, list[str]]:
    """As :func:`_plan_half`, in the view of the tool.

    A ``preform`` is as steep as it was made, which is looked at where it is made, and is formed as deep as the tool
    goes: neither is a fault of the part. ``alone``: this is the whole part. ``of_part``: features of the part that it
    becomes, None without partial paths.
    """
    job, rig = swapped(job_file.job, half.forming_tool), job_file.rig
    radius = job.tool_1.ball_radius
    part = mesh_checks.check_and_place(half.mesh, rig.clamp.size, job.tool_1.radius, place=job.place)
    part_checks.check_fit(part, job, rig)
    if job.process == "ADSIF":
        adsif_path.check_reachable(part.mesh, adsif_path.surface_for(job_file))
    warnings = list(part.warnings if half.base == 0.0 else ())  # told once, with the height of the flange
    if not preform:
        alone &= half.forming_tool == 1
        warnings += part_checks.check_wall_angle(part.mesh, job, job_file.material, alone=alone)

    step("sampling the surface", 0.05)
    surface = target_surface.fine_surface(part.mesh, radius)
    step("dropping the tool", 0.3)
    x, y, height = tip_surface.tip_grid(surface, radius)
    depth, left = part.depth, 0.0
    if preform:
        depth = tip_surface.reached_depth(surface, height, depth, radius)
    else:
        left, remains = part_checks.check_reach(surface, height, depth, radius)
        warnings += remains

    grid = sections.TipGrid(x, y, height, depth)
    found = (of_part or find_features(part.mesh, radius)) if job.path.partial_paths else None
    by_feature = feature_levels(grid, surface, found, job, own=of_part is None) if found else None
    if by_feature:
        levels = by_feature.z
    elif job.path.spacing == "depth":
        levels = tip_loops.levels(depth, job.path.incremental_depth)
    else:
        levels = level_spacing.levels(grid, surface, job)
    nodes, reported = sections.trace(grid, levels, job)
    warnings += reported
    if not preform:
        part_checks.check_pockets(part.mesh, levels, nodes, radius)
    tree = sections.settle_all(nodes, surface, job, lambda k, n: step(f"contour {k + 1} of {n}", 0.4 + 0.5 * k / n))
    shift = part.mesh.vertices.min(axis=0) - half.mesh.vertices.min(axis=0)
    partial = partial_paths(tree, found, by_feature, radius) if found and by_feature else None
    if partial and by_feature and of_part is None:
        warnings += [*without_path(partial, by_feature, surface, radius), *sequencing.near_ribs(tree, partial, radius)]
    return Side(tree, surface, half.forming_tool, half.base, partial, left), shift, warnings


@dataclass(frozen=True)
class Steps:
    """Reports the progress and stops when the plan is cancelled."""

    progress: Progress
    cancelled: Cancelled

    def __call__(self, phase: str, share: float) -> None:
        if self.cancelled():
            raise IsfError(ErrorCode.PLAN_CANCELLED, "planning was cancelled", where=phase)
        self.progress(phase, share)

    def part(self, begin: float, end: float) -> Steps:
        """For work whose shares 0 to 1 are ``begin`` to ``end`` of the whole."""
        return Steps(lambda phase, share: self.progress(phase, begin + (end - begin) * share), self.cancelled)
