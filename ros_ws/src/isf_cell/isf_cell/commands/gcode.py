"""``isf gcode``: a program read, checked as a plan is, drawn, and formed on the simulated machine."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import trimesh
import yaml
from isf_analysis.bag.bag_writer import write_bag
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import torn
from isf_core.files import quantity, yaml_file
from isf_core.files.job import JobFile, load_job
from isf_core.files.rig import load_rig
from isf_core.files.tooling import ToolSpec
from isf_planner import Plan
from isf_planner.gcode.program_check import checked
from isf_planner.gcode.program_plan import forming_points
from isf_planner.gcode.reader import Finding, Program, program_text, read_program
from isf_planner.gcode.set_up import SetUp, cell_set_up, load_set_up
from isf_planner.view.program_figure import draw_program

from isf_cell import in_process
from isf_cell.commands import terminal
from isf_cell.commands.exit_codes import ReportedError
from isf_cell.commands.form import form_in
from isf_cell.commands.plan import job_name, reach, tool_axis
from isf_cell.commands.report import finish, first_failure
from isf_cell.commands.run_folder import run_folder
from isf_cell.commands.simulate import ctrl_c_stops_between_contours, stopped
from isf_cell.options import UNCORRECTED, RunOptions
from isf_cell.run.part_step import PartStep

_PROGRAM_JOB = """\
# made by isf gcode for a program without a job: sheet and tools as given there
name: {name}
part: {{mesh: part.stl, unit: m}}
process: {process}
rig: {rig}
sheet: {{material: {material}, thickness: {thickness}}}
tool_1: {{{tip}}}
{lower}path: {{incremental_depth: 0.5 mm, point_spacing: {step}, feed: {feed}}}
control: {{support_force: 0 N}}
springback: {{method: none}}
"""

DEFAULT_RIG = "ren2018"
"""Where neither a job nor a rig is named."""

STEP, FEED = 1.0, 30.0
"""mm and mm/s, where neither the command line nor a job says it."""

_OF_SUPPORT = {"support_force", "force_rules", "components", "vertical_force", "tangential_force"}
"""Fields of control that a program has no place for."""

SHOWN = 10
"""Findings that are shown at the terminal; all are in the JSON object."""


@dataclass(frozen=True)
class Sheet:
    """What a program does not tell, as texts with units; used where no job is given."""

    rig: str | None = None
    material: str = "AA5754-O"
    thickness: str = "1 mm"
    radius: str = "5 mm"


def run_program(
    file: Path,
    job: Path | None,
    sheet: Sheet,
    set_up: Path | None,
    output: Path | None,
    *,
    step: float | None,
    feed: float | None,
    simulate: bool,
    form: bool,
    as_json: bool,
) -> None:
    """Read, check and draw the program in ``file``; ``step`` mm and ``feed`` mm/s. Nothing but files is written to.

    ``set_up``, ``step`` and ``feed`` that are None are those of the job.

    Raises
    ------
    IsfError : the first finding, after all are reported; what reading and forming raise
    """
    if simulate and form:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "forms it in this process, or through the graph",
            where="--simulate, --form",
            advice="leave one out",
        )
    text = program_text(file)
    given = load_job(job) if job else None
    if given is not None:
        path = given.job.path
        step = 1e3 * path.point_spacing if step is None else step
        feed = 1e3 * path.feed if feed is None else feed
        if set_up is None and path.set_up is not None:
            set_up = given.base / path.set_up
    step, feed = step or STEP, feed or FEED
    values, source = _set_up(set_up, given.rig.name if given else load_rig(_rig_path(sheet.rig or DEFAULT_RIG)).name)
    with run_folder(output, job_name(file.stem)) as folder:
        with terminal.console.status("reading"):
            program = read_program(text, values, name=file.name, step=1e-3 * step, feed=1e-3 * feed)
            job_file = given or _job_of(program, file, sheet, values, folder, step, feed)
        other = given.job.tool_1 if given else ToolSpec(radius=_radius(sheet))
        found = checked(program, job_file, values, other)
        program, findings, plan = found.program, found.findings, found.plan
        data = found.numbers() | {"set_up": str(source) if source else ""}
        if plan is not None:
            data["tool_axis"] = tool_axis(plan)
        if len(program):
            data["picture"] = str(draw_program(program, findings, job_file.rig, folder / "program.png"))
        if plan is not None and given is None:
            trimesh.Trimesh(*plan.mesh, process=False).export(folder / "part.stl")
            (folder / "job.yaml").write_text(job_file.text, encoding="utf-8")
        to_form = folder / "program.yaml"
        if plan is not None and found.failure is None:
            to_form.write_text(_job_with_program(job_file, program, file, source, step, feed), encoding="utf-8")
            data["job"] = str(to_form)
        if plan is not None:
            data |= reach(plan, job_file.job, job_file.rig, folder)
        failure = found.failure
        _show(program, findings, data)
        if form and failure is None:
            form_in(
                folder,
                to_form,
                load_job(to_form),
                RunOptions(),
                compare=False,
                lockstep=True,
                dashboard=False,
                as_json=as_json,
                told=data,
            )
            return
        if plan is None or failure is not None or not simulate:
            if as_json:
                terminal.print_json(data)
            if failure is not None:
                raise ReportedError(failure)
            return
        _simulate(job_file, plan, folder, data, as_json=as_json)


def _simulate(job_file: JobFile, plan: Plan, folder: Path, data: dict[str, Any], *, as_json: bool) -> None:
    """Form ``plan`` as it stands, without correction, and report it; Ctrl-C ends it after the present contour."""
    title = f"{job_file.job.name} (program, in process)"
    with terminal.part_progress(title) as progress, ctrl_c_stops_between_contours() as request:

        def formed(step: PartStep) -> None:
            request.contour_formed()
            progress.contour(step)

        options = RunOptions(correction=UNCORRECTED)
        record = in_process.form(job_file, options, part_plan=plan, progress=formed, cancelled=lambda: request.wanted)
        write_bag(record, folder / "bag")
    failure = torn(record.events) or first_failure(record.results) or stopped(record)
    formed_too = {"contours_formed": len(record.results), "sheet": dict(record.sheet)}
    try:
        finish(folder, None, failure=failure, as_json=as_json, counts=data | formed_too)
    except ReportedError:
        raise
    except IsfError as error:  # formed, but so shallow that there is nothing to compare
        if failure is not None or error.code != ErrorCode.BAG_INCOMPLETE:
            raise
        terminal.warn(f"formed, without a report: {error.what}")
        if as_json:
            terminal.print_json(data | formed_too)


def _set_up(file: Path | None, rig: str) -> tuple[SetUp, Path | None]:
    """Work offsets and tools: of ``file``, else those that were stored for the cell of the rig; and where they are."""
    return (load_set_up(file), file) if file is not None else cell_set_up(rig)


def _job_of(
    program: Program, file: Path, sheet: Sheet, set_up: SetUp, folder: Path, step: float, feed: float
) -> JobFile:
    forming = program.tool[forming_points(program)]
    tool = set_up.tools.get(int(forming[0])) if len(forming) else None
    tip = tool.tip if tool is not None else None
    written = f"radius: {json.dumps(sheet.radius if tip is None else _millimetres(tip.radius))}"
    if tip is not None and tip.corner_radius is not None:
        written += f", corner_radius: {_millimetres(tip.corner_radius)}"
    text = _PROGRAM_JOB.format(
        name=job_name(file.stem),
        process="DSIF" if program.two_tools else "SPIF",
        rig=json.dumps(_rig_path(sheet.rig or DEFAULT_RIG)),
        material=json.dumps(sheet.material),
        thickness=json.dumps(sheet.thickness),
        tip=written,
        lower=f"tool_2: {{{written}}}\n" if program.two_tools else "",
        step=f"{step:.6g} mm",
        feed=f"{feed:.6g} mm/s",
    )
    return JobFile(text, folder, str(file))


def _job_with_program(
    job_file: JobFile, program: Program, file: Path, set_up: Path | None, step: float, feed: float
) -> str:
    """Job that forms the program in ``file`` with sheet, tools and rig of ``job_file``, without correction.

    Its paths are absolute. A program holds no support forces, and says itself where the tool goes and how it leans.
    """
    data = yaml_file.content(job_file.text, job_file.job.name)
    for section in ("part", "adsif", "die", "tool_axis", "springback"):
        data.pop(section, None)
    data["name"] = job_name(file.stem)
    data["process"] = "DSIF" if program.two_tools else "SPIF"
    if not program.two_tools:
        data.pop("tool_2", None)
    control = {key: value for key, value in data.get("control", {}).items() if key not in _OF_SUPPORT}
    data["control"] = {**control, "support_force": "0 N"}
    data["rig"] = _absolute(data["rig"], job_file.base)
    data["sheet"]["material"] = _absolute(data["sheet"]["material"], job_file.base)
    path = {"program": str(file.resolve()), "point_spacing": f"{step:.6g} mm", "feed": f"{feed:.6g} mm/s"}
    if set_up is not None:
        path["set_up"] = str(set_up.resolve())
    told = yaml.safe_dump({**data, "path": path}, sort_keys=False, allow_unicode=True)
    return f"# made by isf gcode: forms the program; isf form and isf simulate take it\n{told}"


def _absolute(named: str, base: Path) -> str:
    """The path of a file made absolute; a name of the library as it is."""
    return str((base / named).resolve()) if named.endswith((".yaml", ".yml")) else named


def _millimetres(length: float) -> str:
    return f"{1e3 * length:.6g} mm"


def _radius(sheet: Sheet) -> float:
    """m, of tools that the set-up gives none."""
    try:
        return quantity.parse(sheet.radius, "m")
    except ValueError as error:
        advice = 'write for example "5 mm"'
        raise IsfError(ErrorCode.FILE_UNIT, str(error), where="--radius", advice=advice) from error


def _rig_path(rig: str) -> str:
    """A file relative to here, made absolute; a name as it is."""
    path = Path(rig)
    return str(path.resolve()) if path.suffix in (".yaml", ".yml") else rig


def _show(program: Program, findings: list[Finding], data: dict[str, Any]) -> None:
    terminal.say(
        f"{data['points']} points, {data['contours']} contours, path {data['path_m']:.2f} m, "
        f"{data['time_s'] / 60:.1f} min on {data['rig']}: "
        + ("nothing is at fault" if data["feasible"] else "the program cannot be formed")
    )
    for word in program.unknown[:SHOWN]:
        terminal.warn(f"{program.name}:{word.line}: {word.word} is not understood in '{word.text}'")
    for finding in findings[:SHOWN]:
        terminal.warn(str(finding.error))
    if (more := len(program.unknown) + len(findings) - 2 * SHOWN) > 0:
        terminal.warn(f"up to {more} more; --json lists them")
    for text in (*data["remarks"], *data["warnings"]):
        terminal.warn(text)
    for stop in data.get("stops", ())[:SHOWN]:
        where = "lifted off the sheet" if stop["lifted"] else "on the sheet"
        terminal.say(f"waits   after contour {stop['after_contour']}, tool {where} (M0 in line {stop['line']})")
    if "job" in data:
        terminal.say(f"job     {data['job']}, for isf form and isf simulate")
    if data["set_up"]:
        terminal.say(f"set-up  {data['set_up']}")
    if "picture" in data:
        terminal.say(f"picture {data['picture']}")
    if "picture" in data.get("machine", {}):
        terminal.say(f"reach   {data['machine']['picture']}")
