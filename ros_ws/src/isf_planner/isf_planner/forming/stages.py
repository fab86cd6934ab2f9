"""Multi-stage forming: preforms with flatter walls, so that material is drawn from where the last stage cannot reach.

A wall steeper than the material bears in one pass is formed in stages. Two kinds of preforms:

* ``path.stages``: one for every wall angle that is given, 3 or 5 deg steeper from stage to stage (Hirt 2004 in Lu 2016,
  2.3.2): the lowest surface above the part that is nowhere steeper. It keeps the opening, and reaches the floor where
  there is room for it; where its walls meet before, it ends where the tool does. An angle that the part itself does not
  exceed makes no shape before it.
* ``path.morph``: shapes between the flat blank and the part, which get deeper and steeper at once, so that no floor is
  formed long before the walls around it (Behera 2015; :mod:`isf_planner.morphing`).

A finishing pass (``path.finishing_passes``) forms the part once more and is a stage of its own.

Of every stage it is known how near the sheet comes to folding over after the stage before
(:mod:`isf_planner.morphing.fold_over`), how thin it is, and what is left of its forming limit
(:mod:`isf_planner.forming.carried_sheet`). How steep each may be: :mod:`isf_planner.forming.permission`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile, MorphSpec
from isf_core.files.material import forming_limit
from isf_core.geometry.height_map import HeightMap

from isf_planner.features.segmentation import find_features
from isf_planner.forming.carried_sheet import CarriedSheet, carried
from isf_planner.forming.permission import Wall, check_steps, largest
from isf_planner.forming.sides import HalfPart
from isf_planner.morphing.chain import Chain, make_chain, on_finer_grid, steepest, steepest_place
from isf_planner.morphing.fold_over import UNCHANGED, FoldOver, fold_over
from isf_planner.morphing.rules import rules_of
from isf_planner.morphing.selection import FIRST_SHARE, STEEPER, Spacing, not_reached, select, with_smaller_steps
from isf_planner.part.mesh_checks import place_text, steepest_wall
from isf_planner.part.meshes import Mesh
from isf_planner.surface import height_grid, surface_kernels

PITCH_PER_RADIUS = 0.1
"""Pitch of a preform's facets over the tool radius."""

LARGEST_GRID = 600
"""Most facets of a preform along one side."""

MORPH_PITCH = 0.2
"""Pitch of the grid on which a part is morphed, over the tool radius."""

LARGEST_MORPH = 200
"""Most cells of that grid along one side."""

LIFTED = 0.5e-3
"""m, by how much a morph may have to be lifted onto the part before it is worth a warning."""

SAME = 0.05e-3
"""m, a preform that lies nowhere farther above the part is the part itself: facets say no more."""

CLOSE = 0.95
"""Part of the forming limit above which a stage is warned of."""

STEEP_MARGIN = np.radians(1.0)
"""rad, a wall of a stage is looked at for folds from this much below the angle of the first stage."""


@dataclass(frozen=True)
class Stage:
    """What one stage ends with.

    Attributes
    ----------
    heights : the surface to be formed, m, flange at z = 0; in a groove of a shape before the part the tool stops above
    fold_over : after the stage before; None for the first one
    sheet : material of the blank at its end, with what is left of the forming limit; None before there are contours
    """

    heights: HeightMap
    fold_over: FoldOver | None
    sheet: CarriedSheet | None = None

    @property
    def depth(self) -> float:
        """m, of the deepest point."""
        return float(-self.heights.z.min())

    @property
    def wall_angle(self) -> float:
        """rad, of its steepest walls."""
        return steepest(self.heights)


@dataclass(frozen=True)
class Preforms:
    """What is formed before the part.

    Attributes
    ----------
    parts : what the upper tool forms, in order
    stages : of these, of the part itself and of its finishing passes; none of a part formed in one stage
    warnings : what to look at
    """

    parts: tuple[HalfPart, ...] = ()
    stages: tuple[Stage, ...] = ()
    warnings: tuple[str, ...] = ()


def preforms(
    mesh: Mesh, forming_tools: Sequence[int], job_file: JobFile, step: Callable[[str, float], None]
) -> Preforms:
    """What the upper tool forms in the stages before the last one, from the whole part ``mesh``, its flange at z = 0.

    Parameters
    ----------
    forming_tools : tools that form the part, 1 and 2
    step : told a phase and a share

    Raises
    ------
    IsfError : FEATURES_MIXED when the part also rises above the blank; PART_TOO_SMALL_FOR_TOOL; MORPH_NOT_REACHED;
        WALL_TOO_STEEP of a stage (:mod:`isf_planner.forming.permission`)
    """
    job = job_file.job
    morph, finishing = job.path.morph, job.path.finishing_passes
    if not job.path.stages and morph is None and (not finishing or list(forming_tools) != [1]):
        return Preforms()
    where = "path.stages" if morph is None else "path.morph"
    if list(forming_tools) != [1]:
        raise IsfError(
            ErrorCode.FEATURES_MIXED,
            "stages are planned only for parts that the upper tool forms alone",
            where=where,
            advice=f"leave {where} out, or give the features as parts of their own",
        )
    radius = job.tool_1.ball_radius
    part = height_grid.sample(mesh, _pitch(mesh, PITCH_PER_RADIUS * radius, LARGEST_GRID), 0.0)
    reported: list[str] = []
    if morph is None and not job.path.stages:
        return Preforms(stages=(Stage(part, None), *[Stage(part, UNCHANGED)] * finishing))
    steepest_of_part = Wall(*steepest_wall(mesh))
    single = job_file.material.max_wall_angle
    if morph is None:
        shapes = _by_angles(part, job.path.stages, radius, step, reported)
        angles = list(job.path.stages[: len(shapes)])
        steep = job.path.stages[0] - STEEP_MARGIN
        measure = MorphSpec().gap
    else:
        single = morph.failure_angle or single
        steep = morph.first_angle or FIRST_SHARE * single
        measure = morph.gap
        shapes, angles = _morphed(mesh, part, job, morph, single, steepest_of_part.angle, steep, step, reported)
    reported += check_steps(
        [*(Wall(angle, steepest_place(shape)) for angle, shape in zip(angles, shapes, strict=True)), steepest_of_part],
        single,
        option=where,
        count=len(shapes) + 1 + finishing,
        overruled=job.wall_angle_limit is not None,
        uncertain=0.0 if morph is None else STEEPER,
    )
    folds = [fold_over(a, b, radius, steep, measure) for a, b in pairwise([*shapes, part])]
    stages = tuple(Stage(shape, fold) for shape, fold in zip([*shapes, part], [None, *folds], strict=True))
    stages += (Stage(part, UNCHANGED),) * finishing
    worst = max(range(len(folds)), key=lambda k: folds[k].ratio, default=None)
    if worst is not None and folds[worst].ratio > 1.0:
        fold = folds[worst]
        reported.append(
            f"the sheet may fold over at {place_text(fold.place)}: stage {worst + 2} of {len(stages)} leaves "
            f"{fold.gap_text} to the wall of the stage before, {fold.ratio:.1f} times what the tool bridges "
            f"({fold.limit * 1e3:.1f} mm)"
        )
    halves = tuple(HalfPart(height_grid.as_mesh(shape), 1) for shape in shapes)
    return Preforms(halves, stages if len(stages) > 1 else (), tuple(reported))


def with_sheet(made: Sequence[Stage], contours: Sequence[Contour], job_file: JobFile) -> tuple[Stage, ...]:
    """The stages ``made`` with the sheet that the ``contours`` of all of them leave."""
    job, limit = job_file.job, forming_limit(job_file.material)
    shapes = [stage.heights for stage in made]
    sheets = carried(shapes, contours, job.tool_1.ball_radius, job.sheet.thickness, limit)
    return tuple(replace(stage, sheet=sheet) for stage, sheet in zip(made, sheets, strict=True))


def strain_warnings(made: Sequence[Stage], job_file: JobFile) -> tuple[str, ...]:
    """Warning with the place of the first stage that uses up the forming limit, or comes nearest to it."""
    limit = forming_limit(job_file.material)
    margins = [stage.sheet.least_margin for stage in made if stage.sheet is not None]
    if not margins or min(margins) > (1.0 - CLOSE) * limit.strain:
        return ()
    number = next((k for k, margin in enumerate(margins) if margin < 0.0), int(np.argmin(margins)))
    sheet = made[number].sheet
    assert sheet is not None  # its margin was taken
    word = "is expected to tear" if margins[number] < 0.0 else "comes close to tearing"
    return (
        f"stage {number + 1} of {len(made)} at {place_text(sheet.place)}: the sheet {word}: thinning and bends of all "
        f"passes use up a strain of {limit.strain - margins[number]:.2f}, {job_file.material.name} bears "
        f"{limit.strain:.2f}; the thinnest place is left with {sheet.thinnest * 1e3:.2f} mm",
    )


def joined(groups: Sequence[Sequence[Contour]]) -> tuple[Contour, ...]:
    """Contours of all stages, in order, as one plan; both tools are lifted between stages."""
    count = sum(len(group) for group in groups)
    found: list[Contour] = []
    for stage, group in enumerate(groups):
        for k, contour in enumerate(group):
            retract = contour.retract or (stage > 0 and k == 0)
            found.append(replace(contour, index=len(found), count=count, stage=stage, retract=retract))
    return tuple(found)


def preform(part: HeightMap, wall_angle: float, radius: float) -> HeightMap:
    """Lowest surface above ``part`` that is nowhere steeper than ``wall_angle`` (rad), for a tool of ``radius`` m.

    Where its walls meet in a point or a groove the tool will stop above that.

    Raises
    ------
    IsfError : PART_TOO_SMALL_FOR_TOOL when nothing is left to be formed at that angle
    """
    flange = float(part.z.max())
    z = surface_kernels.hung(part.z, float(np.tan(wall_angle)) * height_grid.pitch_of(part))
    if flange - z.min() < 0.1 * radius:
        raise IsfError(
            ErrorCode.PART_TOO_SMALL_FOR_TOOL,
            f"nothing is formed with walls of {np.degrees(wall_angle):.0f} deg",
            where="path.stages",
            advice="leave this stage out, or make it steeper",
        )
    return HeightMap(part.x, part.y, z)


def _by_angles(
    part: HeightMap, angles: Sequence[float], radius: float, step: Callable[[str, float], None], reported: list[str]
) -> list[HeightMap]:
    """Preforms of the ascending wall ``angles`` (rad) that are not the part itself."""
    shapes: list[HeightMap] = []
    for number, angle in enumerate(angles):
        step("shapes before the part", number / len(angles))
        shape = preform(part, angle, radius)
        if (shape.z - part.z).max() <= SAME:
            left = ", ".join(f"{np.degrees(one):g}" for one in angles[number:])
            reported.append(
                f"path.stages: the part is no steeper than {np.degrees(angle):g} deg; before it, walls of {left} deg "
                "would form the part itself and are left out"
            )
            break
        shapes.append(shape)
    return shapes


def _pitch(mesh: Mesh, wanted: float, cells: int) -> float:
    return max(wanted, float(np.ptp(mesh.vertices[:, :2], axis=0).max()) / cells)


def _morphed(
    mesh: Mesh,
    part: HeightMap,
    job: Job,
    morph: MorphSpec,
    failure: float,
    wall: float,
    first: float,
    step: Callable[[str, float], None],
    reported: list[str],
) -> tuple[list[HeightMap], list[float]]:
    """Shapes between blank and part on the grid of ``part``, the flattest first, and their steepest walls, rad.

    ``wall``: rad, the steepest of the part.
    """
    if first > failure:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"the first shape would be {np.degrees(first):.0f} deg steep, the sheet fails at {np.degrees(failure):.0f}",
            where="path.morph.first_angle",
            advice="a flatter one, or leave it out: two thirds of the failure angle",
        )
    step("features of the part", 0.0)
    chain = morph_chain(mesh, job, morph, failure)
    spacing = Spacing(job.tool_1.ball_radius, first, morph.gap, morph.most_shapes)
    keep_limit = morph.fold_over == "enforce"
    places = list(
        select(chain, spacing, morph.shapes, keep_limit=keep_limit, look=lambda: step("shapes before the part", 0.5))
    )
    if places and wall > failure and job.wall_angle_limit is None and morph.shapes is None:
        allowed = partial(largest, single=failure)
        places = list(with_smaller_steps(chain, places, wall, allowed, morph.most_shapes))
    if not places:
        reported.append(
            f"path.morph: the part is no steeper than {np.degrees(first):.0f} deg, which is formed in one pass; "
            "nothing is formed before it"
        )
    lifted, place = max((chain.lifted(at) for at in places), key=lambda one: one[0], default=(0.0, None))
    if place is not None and lifted > LIFTED:
        reported.append(
            f"the morph would pass {lifted * 1e3:.1f} mm below the part at {place_text(place)}: its shapes lie on the "
            "part there, which is formed early"
        )
    shapes = [on_finer_grid(chain.shape(at), part) for at in places]
    if keep_limit:
        _insert_missing(chain, part, spacing, places, shapes, morph.shapes or morph.most_shapes)
    return shapes, [steepest(chain.shape(at)) for at in places]


def _insert_missing(
    chain: Chain, part: HeightMap, spacing: Spacing, places: list[float], shapes: list[HeightMap], most: int
) -> None:
    """Shapes in between where the finer grid of ``part`` shows a step that is too large; changes both lists.

    Raises
    ------
    IsfError : MORPH_NOT_REACHED when that makes more than ``most`` shapes
    """
    k = 0
    while k < len(shapes):
        after = shapes[k + 1] if k + 1 < len(shapes) else part
        found = fold_over(shapes[k], after, spacing.radius, spacing.first_angle, spacing.measure)
        if found.ratio <= 1.0:
            k += 1
            continue
        if len(shapes) >= most:
            raise not_reached(found, len(shapes), most)
        places.insert(k + 1, 0.5 * (places[k] + (places[k + 1] if k + 1 < len(places) else 0.0)))
        shapes.insert(k + 1, on_finer_grid(chain.shape(places[k + 1]), part))


def morph_chain(mesh: Mesh, job: Job, morph: MorphSpec, failure: float) -> Chain:
    """Chain of shapes of the part ``mesh``, its flange at z = 0, whose sheet fails at ``failure`` rad."""
    radius = job.tool_1.ball_radius
    coarse = height_grid.sample(mesh, _pitch(mesh, MORPH_PITCH * radius, LARGEST_MORPH), 0.0)
    rules = rules_of(find_features(mesh, radius), coarse, failure, radius)
    width = radius if morph.joint_width is None else morph.joint_width
    return make_chain(coarse, rules, (width, morph.joint_share), morph.method, morph.chi)
