"""``isf plan``: contours of a part, with a picture and a table."""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.bag.open_bag import bag_of
from isf_core.contour import Contour, passes_over_floors
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import Job, JobFile, load_job
from isf_core.files.rig import Rig
from isf_planner import Plan, exports, plan
from isf_planner.checks.arm_checks import ArmClearance, ArmPath, arm_paths, clearances
from isf_planner.checks.backing_plate import nearer_plate, plate_file
from isf_planner.checks.leg_checks import leg_path
from isf_planner.exports.plate_drawing import plate_drawing
from isf_planner.features.segmentation import find_features
from isf_planner.features.surface_features import FeatureMap
from isf_planner.part import meshes
from isf_planner.part.meshes import Mesh
from isf_planner.paths import support_tool
from isf_planner.view import feature_view, plan_view
from isf_planner.view.arm_figure import arm_pictures
from isf_planner.view.plan_figure import draw_plan
from isf_planner.view.reach_figure import axes_use, draw_reach, hexapod_of

from isf_cell.commands import plan_contours, terminal
from isf_cell.commands.plan_contours import WantedMarks
from isf_cell.commands.resume import being_formed, with_advice
from isf_cell.commands.run_folder import TRYOUT, TRYOUT_JOB, make_run_folder
from isf_cell.corrected_plan import NO_TARGET, CorrectedPlan, as_formed, corrected_ahead, uncorrected

_MESH_JOB = """\
# made by isf plan for a mesh without a job file: single-point forming with common values
name: {name}
part: {{mesh: {mesh}{unit}}}
process: SPIF
rig: ren2018
sheet: {{material: AA5754-O, thickness: 1.0 mm}}
tool_1: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
"""


FEATURES = "features"
"""What ``--colour`` shows besides the quantities of the paths."""


@dataclass(frozen=True)
class Wanted:
    """Files that are wanted besides picture and table: exports in one format, views in three dimensions.

    ``per_stage``: a file for every stage of each export. ``marks``: surface for which a depth step is told.
    ``as_planned``: exports are not corrected for springback. Of a recorded part ``incomplete``: also of one that is not
    whole, ``namespace``: its cell, ``base``: folder that paths in its job refer to.
    """

    export: tuple[Path, ...] = ()
    form: str | None = None
    show: tuple[Path, ...] = ()
    colour: str = "wall_angle"
    as_planned: bool = False
    incomplete: bool = False
    namespace: str | None = None
    base: Path | None = None
    per_stage: bool = False
    marks: WantedMarks = field(default_factory=WantedMarks)


def plan_part(part: Path, unit: str | None, output: Path | None, wanted: Wanted, *, as_json: bool) -> None:
    """Plan a job or a bare mesh, or take a plan file or a recorded part; raises IsfError as the planner does."""
    if part.suffix.lower() == ".npz":
        _convert(part, wanted, as_json=as_json)
        return
    if is_run(part):
        _export_run(part, wanted, as_json=as_json)
        return
    job_file = _job_of(part, unit)
    _check_exports(wanted, job_file.job)
    with terminal.console.status("planning") as status:
        result = plan(job_file, progress=lambda phase, share: status.update(f"{phase} {100 * share:.0f} %"))
        exported = _corrected(result, job_file, wanted)
        listed = plan_contours.contour_table(result, job_file)
        marks = plan_contours.marks_numbers(listed, result, job_file, wanted.marks)
    folder = make_run_folder(output, f"plan-{job_file.job.name}")
    picture = draw_plan(result, job_file, folder / "plan.png")
    table = folder / "contours.csv"
    _write_table(result, table)
    warnings = [*result.warnings, *plan_contours.ridge_warning(listed.surface, result, job_file)]
    data = _numbers(result) | {"picture": str(picture), "table": str(table), "warnings": warnings}
    by_contour = plan_contours.write_rows(listed.rows, folder / "by_contour.csv")
    data |= {"contour_table": str(by_contour), "by_contour": list(listed.rows), "tool_marks": marks}
    found = None
    if as_json or wanted.colour == FEATURES:  # they take as long as the plan of a simple part
        found = find_features(Mesh(*result.mesh), job_file.job.tool_1.ball_radius)
        data |= {"features": found.counts()}
    data |= {"files": [str(path) for path in _write(result, wanted, found, job_file.rig, exported)]}
    data |= {"exported": exported.numbers() if exported is not None else None}
    data |= {"support_force": support_tool.chosen_force(job_file.job, result.contours)}
    data |= {"finishing_passes": job_file.job.path.finishing_passes}
    data |= {"tool_axis": tool_axis(result), "accuracy_surfaces": moved_target(result)}
    data |= reach(result, job_file.job, job_file.rig, folder)
    data |= _write_plate(result, job_file, folder)
    if as_json:
        terminal.print_json(data)
    terminal.console.print(
        f"{data['contours']} contours, {data['points']} points, {_path_text(data)}, "
        f"{data['time_s'] / 60:.1f} min at feed; wall angle up to {data['max_wall_angle_deg']:.1f} deg, "
        f"thinnest {data['min_thickness_mm']:.2f} mm{_thickness_of(result, job_file.job)}"
    )
    for line in plan_contours.texts(marks, data["spindle"], job_file):
        terminal.say(line)
    if found is not None:
        terminal.say(f"features: {feature_view.summary_of(found)}")
    for number, stage in enumerate(result.stages, start=1):
        text = f"stage {number} of {len(result.stages)}: {1e3 * stage.depth:.1f} mm deep, "
        text += f"up to {np.degrees(stage.wall_angle):.1f} deg"
        if fold := stage.fold_over:
            text += f", {fold.gap_text} to the wall of the stage before, {fold.ratio:.2f} of the limit"
        if sheet := stage.sheet:
            text += f"; sheet carried from stage to stage {1e3 * sheet.thinnest:.2f} mm at its thinnest, "
            text += f"strain left {sheet.least_margin:.2f}"
        terminal.say(text)
    if passes := data["finishing_passes"]:
        terminal.say(f"{passes} finishing pass{'es' if passes > 1 else ''} over the whole part on the same path")
    if partial := data["partial_paths"]:
        terminal.say(
            f"partial paths: {partial['paths']} of {partial['curves']} curves, joined to {partial['closed']} closed "
            f"contours and {partial['open']} open passes; the tools are lifted {partial['lifts']} times in between"
        )
    if chosen := support_tool.chosen_force(job_file.job, result.contours):
        terminal.say(chosen)
    if leaning := tool_axis_text(data["tool_axis"]):
        terminal.say(leaning)
    if moved := data["accuracy_surfaces"]:
        terminal.say(
            f"accuracy surfaces: target moved by {moved['mean_move_mm']:.2f} mm in the mean, up to "
            f"{moved['largest_move_mm']:.2f} mm, {moved['outside_share']:.0%} of the part outside of what was learned; "
            f"right to {moved['held_out_rms_mm']:.2f} mm (rms) on shapes held out"
        )
    for warning in warnings:
        terminal.warn(warning)
    terminal.say(f"picture {picture}\ntable   {table}, {by_contour.name} beside it")
    for line in arm_text(data["machine"]):
        terminal.say(line)
    if "picture" in data["machine"]:
        terminal.say(f"reach   {data['machine']['picture']}")
    if data["backing_plate"]:
        terminal.say(f"plate   {data['backing_plate']}\n        {data['backing_plate_drawing']}")
    if exported is not None:
        _tell(exported)
    for path in data["files"]:
        terminal.say(f"file    {path}")


def _check_exports(wanted: Wanted, job: Job) -> None:
    """Raise IsfError for exports that no plan of ``job`` can have: it is not planned in vain then."""
    # a process of another package may make stages of its own
    staged = bool(job.path.stages or job.path.morph or job.path.finishing_passes or job.strategy)
    for path in wanted.export:
        exports.check_export(path, wanted.form, over_die=job.process == "TPIF")
        if wanted.per_stage:
            exports.check_stages(path, wanted.form, staged=staged, of=job.name)


def _write_plate(result: Plan, job_file: JobFile, folder: Path) -> dict[str, str | None]:
    """Files of the backing plate that would hold the sheet near the opening, for the job and to cut it by; None where
    none is advised."""
    plate = nearer_plate(result.contours, Mesh(*result.mesh), job_file.job, job_file.rig)
    if plate is None:
        return {"backing_plate": None, "backing_plate_drawing": None}
    path = folder / "backing_plate.yaml"
    path.write_text(plate_file(plate, job_file.job.name), encoding="utf-8")
    drawing = path.with_suffix(".dxf")
    drawing.write_text(plate_drawing(plate), encoding="ascii")
    return {"backing_plate": str(path), "backing_plate_drawing": str(drawing)}


def moved_target(result: Plan) -> dict[str, Any] | None:
    """How accuracy surfaces move the target, for ``--json``; None where none do."""
    moved = result.moved
    if moved is None:
        return None
    size = np.abs(moved.move)
    return {
        "mean_move_mm": 1e3 * float(size[size > 0.0].mean()) if (size > 0.0).any() else 0.0,
        "largest_move_mm": 1e3 * float(size.max()),
        "outside_share": moved.outside,
        "smallest_jacobian": moved.smallest_jacobian,
        "held_out_rms_mm": 1e3 * moved.uncertainty,
    }


def tool_axis(result: Plan) -> dict[str, Any]:
    """How far the tool is tilted and how near its shank and holder come to anything, for ``--json``."""
    data: dict[str, Any] = {
        "tilted_contours": sum(contour.tilted for contour in result.contours),
        "largest_tilt_deg": float(np.degrees(result.largest_tilt)),
    }
    if (shank := result.shank) is not None:
        data |= {
            "clearance_mm": 1e3 * shank.distance,
            "clearance_of": shank.part,
            "clearance_at_mm": (1e3 * shank.place).tolist(),
            "clearance_on_contour": shank.contour + 1,
        }
    return data


def tool_axis_text(data: dict[str, Any]) -> str:
    """The same for people; empty with an upright tool."""
    if not data["tilted_contours"]:
        return ""
    near = ", ".join(f"{value:.1f}" for value in data["clearance_at_mm"])
    return (
        f"tool tilted on {data['tilted_contours']} contours, by {data['largest_tilt_deg']:.1f} deg at most; its "
        f"{data['clearance_of']} comes {max(data['clearance_mm'], 0.0):.1f} mm near to ({near}) mm on contour "
        f"{data['clearance_on_contour']}"
    )


def machine_use(rig: Rig, contours: Sequence[Contour], ball_radius: float) -> dict[str, Any]:
    """Kinematics of the rig for ``--json`` and, of a hexapod, what the planned ``contours`` ask of its cylinders.

    ``ball_radius`` m of the upper tool's tip.
    """
    data: dict[str, Any] = {"kinematics": rig.kinematics}
    hexapod = hexapod_of(rig)
    if hexapod is not None and contours:
        use = axes_use(hexapod, contours, ball_radius)
        data |= {
            "stroke_left_mm": 1e3 * use.margin,
            "largest_joint_angle_deg": float(np.degrees(use.joint_angle)),
            "largest_cylinder_force_N": use.force,
        }
        if (path := leg_path(contours, rig, ball_radius)) is not None and rig.legs is not None:
            data |= {
                "largest_leg_speed_mm_s": 1e3 * float(np.abs(path.speed).max()),
                "largest_pump_flow_share": float(path.flow.max()) / rig.legs.spare_flow,
            }
    return data


def reach(plan: Plan, job: Job, rig: Rig, folder: Path) -> dict[str, Any]:
    """The machine's use for ``--json``, and of a hexapod or of arms the picture of their reach."""
    data = {"machine": machine_use(rig, plan.contours, plan.ball_radius)}
    hexapod = hexapod_of(rig)
    if hexapod is not None:
        data["machine"]["picture"] = str(
            draw_reach(hexapod, plan.contours, rig, folder / "reach.png", plan.ball_radius)
        )
    if paths := arm_paths(plan.contours, rig, plan.ball_radius):
        near = clearances(paths, job, rig)
        data["machine"]["arms"] = [arm_use(path, clearance) for path, clearance in zip(paths, near, strict=True)]
        pictures = arm_pictures(paths, near, rig, folder)
        data["machine"]["picture"] = str(pictures[0])
        data["machine"]["pictures"] = [str(picture) for picture in pictures]
    return data


def arm_use(path: ArmPath, clearance: ArmClearance) -> dict[str, Any]:
    """What a plan asks of one arm, for ``--json``."""
    tight, fast = int(np.argmin(path.margin)), np.unravel_index(int(np.argmax(path.speed)), path.speed.shape)
    soft, give = path.arm.compliance(path.joints), path.give
    return {
        "tool": path.tool,
        "model": path.arm.name,
        "roll_deg": float(np.degrees(path.arm.roll)),
        "joint_margin_deg": float(np.degrees(path.margin[tight])),
        "joint_margin_at_mm": (1e3 * path.tips[tight]).tolist(),
        "singular_deg": float(np.degrees(path.singular.min())),
        "singular_at_mm": (1e3 * path.tips[int(np.argmin(path.singular))]).tolist(),
        "manipulability_m3": float(path.arm.manipulability(path.joints).min()),
        "joint_speed_share": float(path.speed[fast]),
        "fastest_joint": path.arm.joints[int(fast[1])].name,
        "clearance_mm": 1e3 * clearance.distance,
        "clearance_of": clearance.link,
        "clearance_to": clearance.other,
        "clearance_at_mm": (1e3 * path.tips[clearance.row]).tolist(),
        "compliance_um_per_N": (1e6 * np.stack([soft.min(axis=0), soft.max(axis=0)])).tolist(),
        "gives_way_mm": float(1e3 * np.linalg.norm(give, axis=1).max()),
    }


def arm_text(machine: dict[str, Any]) -> list[str]:
    """The same for people, a line for each arm; none without arms."""
    return [
        f"arm of tool {arm['tool']}: {arm['joint_margin_deg']:.0f} deg from the limits of its joints, "
        f"{arm['singular_deg']:.0f} deg from singular poses, joints at {100 * arm['joint_speed_share']:.0f} % of their "
        f"speed, {arm['clearance_of']} {arm['clearance_mm']:.0f} mm from the {arm['clearance_to']}; gives way by "
        f"{arm['gives_way_mm']:.2f} mm under the predicted force"
        for arm in machine.get("arms", [])
    ]


def _convert(path: Path, wanted: Wanted, *, as_json: bool) -> None:
    """Exports and views of a plan file."""
    if not wanted.export and not wanted.show:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            "a plan file is planned already",
            where=str(path),
            advice="add --export FILE or --show FILE",
        )
    result = exports.load_plan(path)
    data = _numbers(result) | {"files": [str(file) for file in _write(result, wanted)]}
    if as_json:
        terminal.print_json(data)
    for line in result.origin:
        terminal.say(line)
    for file in data["files"]:
        terminal.say(f"file    {file}")


def job_of_tryout(part: Path) -> Path:
    """The job that a try-out came to, where ``part`` is its folder; else ``part``. Raises IsfError FILE_NOT_FOUND."""
    if not (part / TRYOUT).is_file():
        return part
    job = part / TRYOUT_JOB
    if not job.is_file():
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND,
            "the try-out has not come to its end",
            where=str(job),
            advice="isf tryout JOB -o FOLDER goes on with it",
        )
    return job


def is_run(part: Path) -> bool:
    """True where ``part`` is a folder or file of a recorded part, by its name."""
    return part.is_dir() or part.suffix.lower() in BAGS


BAGS = (".mcap", ".db3")
"""Endings of files of a bag."""


def _export_run(part: Path, wanted: Wanted, *, as_json: bool) -> None:
    """Exports and views of the contours that a part was formed with."""
    if not wanted.export and not wanted.show:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            "a recorded part is planned already",
            where=str(part),
            advice="add --export FILE for the contours as they were formed, or --show FILE; isf report shows the part",
        )
    run = bag_of(part).parent
    if being_formed(run) and not wanted.incomplete:
        raise IsfError(ErrorCode.BUSY, "the part is being formed", where=str(part), advice="wait until it ends")
    try:
        formed = as_formed(part, wanted.namespace, wanted.base, incomplete=wanted.incomplete, nominal=wanted.as_planned)
    except IsfError as error:
        raise with_advice(error, run) from None
    _check_of_run(formed, part, wanted)
    files = _write(formed.plan, wanted, rig=formed.rig)
    data = _numbers(formed.plan) | {"files": [str(file) for file in files], "exported": formed.numbers()}
    if as_json:
        terminal.print_json(data)
    _tell(formed)
    for file in data["files"]:
        terminal.say(f"file    {file}")


def _check_of_run(formed: CorrectedPlan, part: Path, wanted: Wanted) -> None:
    """Raise IsfError for exports that a record does not hold enough for."""
    forms = [exports.format_of(path, wanted.form) for path in wanted.export]
    if "stl" in forms:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            "a record holds the target on a grid alone, and not the surface that was planned",
            where=str(part),
            advice="export that from the job; isf report RUN --export DIR writes the shape that was formed",
        )
    if formed.plan.target is NO_TARGET and (wanted.show or "plan" in forms):
        raise IsfError(
            ErrorCode.BAG_INCOMPLETE,
            "holds no target (topic part/target), which plan files and views show",
            where=str(part),
            advice="export a program or a table",
        )
    if formed.rig_lost is not None and any(exports.for_arms(form) for form in forms):
        raise formed.rig_lost


def _corrected(result: Plan, job_file: JobFile, wanted: Wanted) -> CorrectedPlan | None:
    """What is exported of the plan of a job, with the corrections that are known before it is formed; None: nothing
    that has contours."""
    if all(exports.format_of(path, wanted.form) == "stl" for path in wanted.export):
        return None
    if wanted.as_planned:
        return uncorrected(result, job_file)
    try:
        return corrected_ahead(result, job_file)
    except IsfError as error:
        advice = "; ".join(filter(None, (error.advice, "--as-planned exports the plan without a correction")))
        raise IsfError(error.code, error.what, where=error.where, advice=advice) from error


def _tell(exported: CorrectedPlan) -> None:
    """What the exports are of, for people."""
    for line in exported.plan.origin:
        terminal.say(line)
    if exported.corrected:
        terminal.say(f"largest correction {1e3 * exported.largest:.2f} mm")
    for remark in exported.remarks:
        terminal.warn(remark)


def _write(
    result: Plan,
    wanted: Wanted,
    found: FeatureMap | None = None,
    rig: Rig | None = None,
    exported: CorrectedPlan | None = None,
) -> list[Path]:
    """Exports, of the contours ``exported`` where they are others than those of ``result``, and views; a plan file has
    no ``found`` features, as it does not know the radius of the tool, and no rig whose arms programs could speak of."""
    arms = (None, None) if rig is None else (rig.arm(1), rig.arm(2))
    of = result if exported is None else exported.plan
    over_die = any(contour.holder_height for contour in of.contours)
    for path in wanted.export:  # all before the first is written
        exports.check_export(path, wanted.form, over_die=over_die)
    write = exports.export_stages if wanted.per_stage else exports.export
    written = [file for path in wanted.export for file in write(of, path, wanted.form, arms)]
    if wanted.colour != FEATURES:
        return written + [plan_view.show(result, path, wanted.colour) for path in wanted.show]
    if found is None:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            "neither a plan file nor a recorded part holds the features of the part",
            advice="show them from the job or the mesh: isf plan JOB --show FILE --colour features",
        )
    contours = [contour for contour in result.contours if contour.stage == result.contours[-1].stage]
    drawn = contours if result.partial else []
    return written + [feature_view.show_features(found, result.plan_id, path, drawn) for path in wanted.show]


def is_mesh(part: Path) -> bool:
    """True where ``part`` is the shape itself, a mesh or a CAD file, by its name."""
    return part.suffix.lower().lstrip(".") in meshes.KNOWN


def _job_of(part: Path, unit: str | None) -> JobFile:
    if not is_mesh(part):
        return load_job(part)
    if unit is None and part.suffix.lower().lstrip(".") in meshes.FORMATS:
        raise IsfError(
            ErrorCode.FILE_UNIT,
            "the mesh file does not state its unit",
            where=str(part),
            advice="add --unit mm (or cm, m, in), or write a job file",
        )
    mesh = json.dumps(str(part.resolve()), ensure_ascii=False)  # a JSON string is a YAML string, whatever is in it
    text = _MESH_JOB.format(name=job_name(part.stem), mesh=mesh, unit=f", unit: {unit}" if unit else "")
    return JobFile(text, part.resolve().parent, str(part))


def job_name(stem: str) -> str:
    """A job name from a file's: letters without their accents, else "_"; "part" when nothing is left."""
    plain = unicodedata.normalize("NFKD", stem)
    kept = "".join(
        c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in plain if not unicodedata.combining(c)
    )
    return kept[:80] if kept.strip("_.-") else "part"


def _numbers(result: Plan) -> dict[str, Any]:
    contours = result.contours
    stages = [
        {
            "depth_mm": 1e3 * stage.depth,
            "wall_angle_deg": float(np.degrees(stage.wall_angle)),
            "gap_over_limit": stage.fold_over.ratio if stage.fold_over else None,
            "gap_at_least": stage.fold_over is not None and stage.fold_over.at_least,
            "thickness_min_mm": 1e3 * stage.sheet.thinnest if stage.sheet else None,
            "margin": stage.sheet.least_margin if stage.sheet else None,
            "margin_at_mm": (1e3 * stage.sheet.place).tolist() if stage.sheet else None,
        }
        for stage in result.stages
    ]
    over = passes_over_floors(contours)
    return {
        "plan_id": result.plan_id,
        "contours": len(contours),
        "points": int(sum(len(contour) for contour in contours)),
        "floor_passes": len(over),
        "path_m": result.path_length,
        "floor_path_m": sum(contour.length for contour in over),
        "time_s": result.forming_time,
        "max_wall_angle_deg": float(np.degrees(result.largest_wall_angle)),
        "min_thickness_mm": 1e3 * result.smallest_thickness,
        "depth_mm": float(-1e3 * min(contour.forming_tip[:, 2].min() for contour in contours)),
        "stages": stages,
        "partial_paths": _partial(result),
        "spindle": plan_contours.spindle_numbers(result),
    }


def _thickness_of(result: Plan, job: Job) -> str:
    """What the thinnest sheet of a plan in stages is, whose stages are told with another one; empty in one stage."""
    if not any(stage.sheet for stage in result.stages):
        return ""
    law = "sine law" if job.path.thickness == "sine_law" else job.path.thickness
    return f" ({law} of the final walls, in one pass; by stage below)"


def _path_text(data: dict[str, Any]) -> str:
    """Length of the path, and how much of it is on the floors."""
    text = f"path {data['path_m']:.2f} m"
    if passes := data["floor_passes"]:
        text += f", {data['floor_path_m']:.2f} of it in {passes} passes over floors"
    return text


def _partial(result: Plan) -> dict[str, int] | None:
    """Counts of the partial paths of all stages and of what they join to; None where none are planned."""
    if not result.partial:
        return None
    closed = sum(contour.closed for contour in result.contours)
    return {
        "paths": sum(len(partial.features) for partial in result.partial),
        "curves": sum(len(partial.curves) for partial in result.partial),
        "closed": closed,
        "open": len(result.contours) - closed,
        "lifts": sum(contour.retract for contour in result.contours),
    }


def _write_table(result: Plan, path: Path) -> None:
    """One row per point: contour, contact, normal, wall angle, thickness, tips, force; mm, degrees, N for people."""
    rows = []
    for contour in result.contours:
        n = len(contour)
        support = 1e3 * contour.support_tip if contour.has_support else np.full((n, 3), np.nan)
        force = contour.support_force if contour.force_controlled else np.full(n, np.nan)
        rows.append(
            np.column_stack(
                [
                    np.full(n, contour.index),
                    1e3 * contour.contact,
                    contour.normal,
                    np.degrees(contour.wall_angle),
                    1e3 * contour.thickness,
                    1e3 * contour.forming_tip,
                    support,
                    force,
                    contour.forming_axis if contour.tilted else np.tile([0.0, 0.0, -contour.push_sign], (n, 1)),
                ]
            )
        )
    header = (
        "contour,contact_x_mm,contact_y_mm,contact_z_mm,normal_x,normal_y,normal_z,wall_angle_deg,thickness_mm,"
        "forming_x_mm,forming_y_mm,forming_z_mm,support_x_mm,support_y_mm,support_z_mm,support_force_N,"
        "axis_x,axis_y,axis_z"
    )
    np.savetxt(path, np.vstack(rows), fmt="%.6g", delimiter=",", header=header, comments="")
