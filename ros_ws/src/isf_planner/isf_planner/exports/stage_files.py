"""A part that is formed in stages as one file per stage: programs, tables, and the shapes that the stages end with.

Stage k is what Behera 2015, Case studies, calls Morph k; the part is the last shape, and a finishing pass over it a
stage of its own with the same shape.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.serial_arm import SerialArm

from isf_planner.exports.target_stl import write_shape
from isf_planner.exports.writer import export, format_of
from isf_planner.part_plan import Plan


def stage_count(plan: Plan) -> int:
    """How many stages the contours of ``plan`` are formed in, finishing passes included."""
    return 1 + max(contour.stage for contour in plan.contours)


def of_stage(plan: Plan, stage: int) -> Plan:
    """The contours of one ``stage`` (from 0) as a plan of its own, ``NAME_stage_1`` with the digest of the whole."""
    name, _, digest = plan.plan_id.rpartition("-")
    plan_id = f"{name}_stage_{stage + 1}-{digest}"
    kept = [k for k, contour in enumerate(plan.contours) if contour.stage == stage]
    contours = tuple(
        replace(plan.contours[k], plan_id=plan_id, index=index, count=len(kept)) for index, k in enumerate(kept)
    )
    spindle = tuple(plan.spindle[k] for k in kept) if plan.spindle else ()
    return replace(plan, plan_id=plan_id, contours=contours, spindle=spindle)


def check_stages(path: Path, form: str | None = None, *, staged: bool, of: str) -> str:
    """Format of the file ``path``, where a part can be written stage by stage in it; ``staged``: it is formed in
    several, ``of``: its name.

    Raises
    ------
    IsfError : EXPORT_FORMAT_UNKNOWN of a part that is formed in one stage, and of format plan, which holds all stages
    """
    known = format_of(path, form)
    if not staged:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            "the part is formed in one stage, there is nothing to be written stage by stage",
            where=of,
            advice="leave --per-stage out, or form it in stages (path.morph, path.stages, path.finishing_passes)",
        )
    if known == "plan":
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            "a plan file holds all stages: it is not written stage by stage",
            where=str(path),
            advice="export it without --per-stage; isf plan FILE.npz --export part.nc --per-stage takes it apart",
        )
    return known


def export_stages(
    plan: Plan,
    path: Path,
    form: str | None = None,
    arms: tuple[SerialArm | None, SerialArm | None] = (None, None),
) -> list[Path]:
    """Write each stage of ``plan`` to a file beside ``path``, ``NAME_stage_1`` and so on, and return the files.

    Of format stl these are the shapes that the stages end with; a finishing pass, which ends with the part's, has none.
    Parameters are those of :func:`isf_planner.exports.export`.

    Raises
    ------
    IsfError : as :func:`check_stages` and :func:`isf_planner.exports.export`
    """
    count = stage_count(plan)
    known = check_stages(path, form, staged=count > 1, of=plan.plan_id)
    written = []
    for stage in range(count):
        target = path.with_name(f"{path.stem}_stage_{stage + 1}{path.suffix}")
        if known != "stl":
            written += export(of_stage(plan, stage), target, form, arms)
        elif stage < len(plan.preforms):
            shape = plan.stages[stage].heights if plan.stages else plan.preforms[stage]
            written.append(write_shape(shape, target))
        elif stage == len(plan.preforms):
            written += export(plan, target, form, arms)
    return written
