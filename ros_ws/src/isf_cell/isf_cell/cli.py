"""The ``isf`` command: plan, simulate, form, run, record, report, doctor."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError
from isf_core.simulated_sheet import sheet_kind
from typer.core import TyperGroup

from isf_cell.commands import bag_cli, hand_cli, springback_cli, terminal
from isf_cell.commands.arguments import Job, Json, Namespace, Output, Seed, Variant, given, numbers, refuse
from isf_cell.commands.exit_codes import Exit, ReportedError, exit_for
from isf_cell.options import RunOptions
from isf_cell.processes.ctrl_c import ctrl_c_handled_by, interrupt
from isf_cell.processes.results_stream import keep_for_results


class _Commands(TyperGroup):
    """The commands; Ctrl-C in any of them is told as what it is, where the parser would end without a word."""

    def invoke(self, ctx: Any) -> Any:
        try:
            with ctrl_c_handled_by(interrupt):
                return super().invoke(ctx)
        except KeyboardInterrupt:
            raise IsfError(ErrorCode.CANCELLED, "stopped by the operator") from None


app = typer.Typer(
    cls=_Commands,
    help="Incremental sheet forming: plan, form and report parts.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Correction = Annotated[
    str | None,
    typer.Option("--correction", help="springback method, auto, or none  [default: the job's]", metavar="NAME"),
]
SupportForce = Annotated[
    float | None, typer.Option("--support-force", help="set-point in N, 0 = position control  [default: the job's]")
]
_SHEETS = "simulated sheet: fast (seconds), shell_coarse, shell or shell_fine (elasto-plastic, minutes)"
Sheet = Annotated[
    str,
    typer.Option(
        "--sheet",
        help=f"{_SHEETS}  [default: fast, or shell_coarse where that one does not know the job]",
        show_default=False,
    ),
]
Compare = Annotated[
    bool, typer.Option(help="also simulate the uncorrected part and show both; off when nothing is corrected")
]


app.add_typer(bag_cli.app, name="bag")
app.add_typer(springback_cli.app, name="springback")
app.add_typer(hand_cli.app)


@app.callback()
def _main() -> None:
    """Incremental sheet forming: plan, form and report parts."""


@app.command()
def plan(
    context: typer.Context,
    part: Annotated[
        Path,
        typer.Argument(
            help="job file (YAML), a mesh with --unit, a CAD file (STEP, IGES, 3MF), a plan (.npz), a run or its bag, "
            "or a try-out",
            metavar="PART",
        ),
    ],
    unit: Annotated[
        str | None, typer.Option(help="unit of the coordinates when PART is a mesh: mm, cm, m or in")
    ] = None,
    export: Annotated[
        list[Path] | None,
        typer.Option(
            help="also write FILE: .npz plan, .csv AMPL tables, .nc .mpf .pmc .src .mod programs", metavar="FILE"
        ),
    ] = None,
    form: Annotated[
        str | None, typer.Option("--format", help="format of --export: a name, or a YAML file of your own")
    ] = None,
    show: Annotated[
        list[Path] | None, typer.Option(help="also write a 3D view to FILE: .html or .png", metavar="FILE")
    ] = None,
    colour: Annotated[
        str,
        typer.Option(
            help="what --show colours: wall_angle, thickness or force of the paths; carried_thickness or margin of a "
            "plan in stages; or the part's features"
        ),
    ] = "wall_angle",
    per_stage: Annotated[
        bool,
        typer.Option("--per-stage", help="export a file for every stage: programs, tables, shapes before the part"),
    ] = False,
    scallop: Annotated[
        str | None, typer.Option(help='tell the depth step for ridges between tool marks of this height: "5 um"')
    ] = None,
    mark_spacing: Annotated[
        str | None, typer.Option(help='tell the depth step for tool marks so far apart along the wall: "0.5 mm"')
    ] = None,
    as_planned: Annotated[
        bool, typer.Option("--as-planned", help="export contours that are not corrected for springback")
    ] = False,
    incomplete: Annotated[
        bool,
        typer.Option("--incomplete", help="of a run that tore or ended early: export what was formed all the same"),
    ] = False,
    base: Annotated[
        Path | None, typer.Option(help="folder that paths in the job of a run refer to  [default: the recorded one]")
    ] = None,
    namespace: Namespace = None,
    output: Output = None,
    json: Json = False,
) -> None:
    """Plan the contours of a part; writes a picture and a table of points. Of a plan file (.npz), or as a run formed
    them, contours are only exported or shown."""
    from isf_cell.commands.plan import FEATURES, Wanted, is_mesh, is_run, job_of_tryout, plan_part
    from isf_cell.commands.plan_contours import wanted_marks

    part = job_of_tryout(part)
    if is_run(part):
        refuse(context, ["--output"], "of a run nothing but --export and --show is written", "leave it out")
    else:
        refuse(context, ["--incomplete", "--base", "--namespace"], f"{part} is no run", "leave it out")
    if not is_mesh(part):
        refuse(context, ["--unit"], f"{part} is no mesh: a job or a plan tells the unit itself", "leave it out")
    if not export:
        refuse(
            context, ["--format", "--as-planned", "--per-stage"], "is of --export", "add --export FILE, or leave it out"
        )
    if not show and colour != FEATURES:  # whose summary is told, too
        refuse(context, ["--colour"], "is what --show colours", "add --show FILE, or leave it out")
    if part.suffix.lower() == ".npz":
        refuse(context, ["--output"], "of a plan file nothing but --export and --show is written", "leave it out")
        refuse(context, ["--as-planned"], "a plan file holds its contours as they are", "leave it out, or give the job")
    if part.suffix.lower() == ".npz" or is_run(part):
        refuse(context, ["--scallop", "--mark-spacing"], f"{part} holds no job to be changed", "give the job")
    files, views = tuple(export or ()), tuple(show or ())
    marks = wanted_marks(scallop, mark_spacing)
    wanted = Wanted(files, form, views, colour, as_planned, incomplete, namespace, base, per_stage, marks)
    plan_part(part, unit, output, wanted, as_json=json)


@app.command()
def gcode(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(help="program (G-code)", metavar="FILE")],
    job: Annotated[
        Path | None, typer.Option("--job", help="sheet, tools and rig of this job; its part is not used", metavar="JOB")
    ] = None,
    rig: Annotated[str | None, typer.Option(help="rig without a job  [default: ren2018]", metavar="NAME")] = None,
    material: Annotated[str, typer.Option(help="of the sheet without a job")] = "AA5754-O",
    thickness: Annotated[str, typer.Option(help="of the sheet without a job")] = "1 mm",
    radius: Annotated[str, typer.Option(help="of the tools without a job")] = "5 mm",
    set_up: Annotated[
        Path | None,
        typer.Option(
            "--set-up",
            help="work offsets and tool library (YAML)  [default: that of the job, else of the cell]",
            metavar="FILE",
        ),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(
            help="largest distance between points, mm  [default: that of the job, else 1]", min=0.051, max=4.999
        ),
    ] = None,
    feed: Annotated[
        float | None,
        typer.Option(help="mm/s until the program gives F  [default: that of the job, else 30]", min=0.101, max=999.9),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="form it on the simulated machine in this process")
    ] = False,
    form: Annotated[bool, typer.Option("--form", help="form it through the node graph, as isf form does")] = False,
    output: Output = None,
    json: Json = False,
) -> None:
    """Read a program: what is not understood or out of reach, by line; picture; optionally form it."""
    from isf_cell.commands.gcode import Sheet, run_program

    if job is not None:
        of_job = ["--rig", "--material", "--thickness", "--radius"]
        refuse(context, of_job, "a job names its own rig, sheet and tools", "leave it out, or --job")
    sheet = Sheet(rig, material, thickness, radius)
    run_program(file, job, sheet, set_up, output, step=step, feed=feed, simulate=simulate, form=form, as_json=json)


@app.command()
def part(
    name: Annotated[str | None, typer.Argument(help="part of the library; none: list them", metavar="NAME")] = None,
    values: Annotated[
        list[str] | None,
        typer.Option("--set", help='change a dimension, such as "depth=12 mm" or "angle=40 deg"', metavar="NAME=VALUE"),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="mesh file in mm  [default: NAME.stl]", metavar="FILE")
    ] = None,
    json: Json = False,
) -> None:
    """Make a part of the library as a mesh, or list the parts and their dimensions."""
    from isf_cell.commands.part import make_part

    make_part(name, tuple(values or ()), output, as_json=json)


@app.command()
def library(
    kind: Annotated[
        str | None, typer.Argument(help="tools, blanks, plates, materials or rigs; none: all", metavar="KIND")
    ] = None,
    name: Annotated[
        str | None,
        typer.Argument(help="show its constants and their origin; a path: check a file of your own", metavar="NAME"),
    ] = None,
    json: Json = False,
) -> None:
    """List the tools, blanks, plates, materials and rigs that a job may name, or the constants of one."""
    from isf_cell.commands.library import show_library

    show_library(kind, name, as_json=json)


@app.command()
def describe(
    name: Annotated[str, typer.Argument(help="rig (name or file), or job file", metavar="RIG|JOB", show_default=False)],
    prefix: Annotated[str, typer.Option(help="before every name in the file, such as left_")] = "",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="URDF file  [default: NAME.urdf]", metavar="FILE")
    ] = None,
    ros2_control: Annotated[
        bool,
        typer.Option("--ros2-control", help="with the block for ros2_control, and NAME_controllers.yaml beside it"),
    ] = False,
    json: Json = False,
) -> None:
    """Describe a cell as URDF: table, clamp, axes, tools and load cells, with limits and masses."""
    from isf_cell.commands.describe import describe_cell

    describe_cell(name, prefix, output, ros2_control=ros2_control, as_json=json)


@app.command()
def simulate(
    job: Job,
    correction: Correction = None,
    support_force: SupportForce = None,
    variant: Variant = 0,
    seed: Seed = 0,
    sheet: Sheet = "",
    release: Annotated[
        bool,
        typer.Option("--release", help="scan the finished part out of the clamp, trimmed, too; not of the sheet fast"),
    ] = False,
    output: Output = None,
    compare: Compare = True,
    json: Json = False,
) -> None:
    """Form a part on the simulated machine in this process, without ROS: seconds instead of minutes."""
    from isf_cell.commands.simulate import simulate_part

    options = RunOptions(correction, support_force, variant, seed, sheet_kind(sheet, "--sheet"), release)
    simulate_part(job, options, output, compare=compare, as_json=json)


@app.command()
def form(
    context: typer.Context,
    job: Annotated[Path | None, typer.Argument(help="job file (YAML)", metavar="JOB", show_default=False)] = None,
    correction: Correction = None,
    support_force: SupportForce = None,
    variant: Variant = 0,
    seed: Seed = 0,
    sheet: Sheet = "",
    output: Output = None,
    compare: Compare = True,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="run by the wall clock instead of in lockstep with the simulation")
    ] = False,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume", help="go on with the part in this folder, at the contour that was not finished", metavar="RUN"
        ),
    ] = None,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="serve a page for the browser while the part is formed")
    ] = False,
    attach: Annotated[bool, typer.Option("--attach", help="form it in the cell that isf cell has started")] = False,
    json: Json = False,
) -> None:
    """Form a part through the ROS 2 node graph: five nodes, recorder and frames, each a process of its own."""
    from isf_cell.commands.form import form_part, resume_part

    if attach and (real_time or dashboard):
        named = "--real-time" if real_time else "--dashboard"
        raise typer.BadParameter(f"{named} is for a cell of its own", ctx=context, param_hint="--attach")
    if resume is not None:
        asked = {
            "JOB": job,
            "--correction": correction,
            "--support-force": support_force,
            "--variant": variant,
            "--seed": seed,
            "--sheet": sheet,
            "--output": output,
            "--real-time": real_time,
        }
        resume_part(resume, given(context, asked), compare=compare, dashboard=dashboard, attach=attach, as_json=json)
        return
    if job is None:
        raise typer.BadParameter("name a job file, or --resume RUN", ctx=context, param_hint="JOB")
    options = RunOptions(correction, support_force, variant, seed, sheet_kind(sheet, "--sheet"))
    form_part(
        job,
        options,
        output,
        compare=compare,
        lockstep=not real_time,
        dashboard=dashboard,
        attach=attach,
        as_json=json,
    )


@app.command()
def cell(
    job: Annotated[
        Path | None, typer.Argument(help="job whose rig, sheet and tools are meant", metavar="JOB", show_default=False)
    ] = None,
    rig: Annotated[str | None, typer.Option(help="rig (name or file) without a job", metavar="NAME")] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="run by the wall clock instead of in lockstep with the simulation")
    ] = False,
    driver: Annotated[
        bool, typer.Option("--driver", help="the cell's own driver is started elsewhere: no simulated machine")
    ] = False,
    page: Annotated[bool, typer.Option("--page", help="serve a page for the browser, too")] = False,
    record: Annotated[bool, typer.Option("--record", help="record all of it, with a text log")] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="folder for logs and bag  [default: runs/cell-TIME]", metavar="DIR"),
    ] = None,
    runs: Annotated[
        Path,
        typer.Option(help="parts with an --output below this folder keep checkpoints, to go on with", metavar="DIR"),
    ] = Path("runs"),
    json: Json = False,
) -> None:
    """Start a cell that stays up until Ctrl-C, for isf form --attach, isf mode, isf jog, isf dashboard and others."""
    from isf_cell.commands.cell import stand

    stand(job, rig, output, runs, lockstep=not real_time, machine=not driver, page=page, record=record, as_json=json)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
def run(
    context: typer.Context,
    package: Annotated[str, typer.Argument(help="package, for example isf_planner")],
    node: Annotated[str, typer.Argument(help="node, for example planner")],
) -> None:
    """Run one node, as `ros2 run` does; the rest of the line goes to the node."""
    from isf_cell.processes import executables

    path = executables.find(package, node)
    os.execv(path, [str(path), *context.args])


@app.command()
def record(
    output: Annotated[Path, typer.Option("--output", "-o", help="folder of the bag; must not exist", metavar="DIR")],
    remap: Annotated[
        list[str] | None,
        typer.Option("--remap", "-r", help="topic that has another name here; repeat for each", metavar="FROM:=TO"),
    ] = None,
    storage: Annotated[str, typer.Option(help="mcap, or sqlite3")] = "mcap",
    compression: Annotated[str, typer.Option(help="none or zstd, of mcap")] = "none",
    split_size: Annotated[float, typer.Option(help="MB after which the next file begins  [default: one file]")] = 0.0,
    split_time: Annotated[float, typer.Option(help="s after which the next file begins  [default: one file]")] = 0.0,
    log: Annotated[
        Path | None, typer.Option("--log", help="also pose and forces as text of 12 columns, 20 rows/s", metavar="FILE")
    ] = None,
    ring: Annotated[
        float, typer.Option(help="s to keep in memory, written when a node reports a fault  [default: write all]")
    ] = 0.0,
) -> None:
    """Record the topics of a running cell until Ctrl-C."""
    from isf_analysis.bag import bag_file, text_log

    from isf_cell.processes import cell_nodes, executables
    from isf_cell.processes.process_group import parameter_value

    for option, number in (("--split-size", split_size), ("--split-time", split_time), ("--ring", ring)):
        if not 0.0 <= number < float("inf"):  # NaN is not
            raise IsfError(ErrorCode.FILE_FIELD, f"{number:g} is no size or time", where=option, advice="0 or more")
    path = executables.find("isf_analysis", "recorder")
    # now: a node that cannot record stays up and waits to be configured anew
    bag_file.Storage(storage, compression, round(1e6 * split_size), split_time)
    bag_file.check_free(output)
    if log is not None:
        text_log.check_free(log)
    values: dict[str, object] = {
        "autostart": True,
        "output": output.absolute(),
        "storage": storage,
        "compression": compression,
        "split_size": split_size,
        "split_time": split_time,
        "ring": ring,
    }
    if log is not None:
        values["text_log"] = log.absolute()
    arguments = ["--ros-args"]
    for name, value in values.items():
        arguments += ["-p", f"{name}:={parameter_value(value)}"]
    for names in remap or ():
        arguments += ["-r", executables.checked_remap(names)]
    os.execv(path, [str(path), *arguments, *cell_nodes.enclave_arguments("recorder")])


@app.command()
def report(
    bag: Annotated[Path, typer.Argument(help="folder of a run, or its bag", metavar="BAG")],
    reference: Annotated[Path | None, typer.Option(help="uncorrected run, or its bag, to compare with")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="folder  [default: beside the bag]")] = None,
    export: Annotated[
        Path | None, typer.Option(help="folder for the formed shape as STL, PLY and VTK, in mm", metavar="FOLDER")
    ] = None,
    section: Annotated[
        list[str] | None,
        typer.Option(
            help="draw this section, too (mm, deg): y=12.5, x=0, 30deg (from x, through the middle) or 30deg@10,-5; "
            "again for each",
            metavar="PLANE",
        ),
    ] = None,
    namespace: Namespace = None,
    json: Json = False,
) -> None:
    """Make the report of a recorded part: one HTML file and its pictures."""
    from isf_cell.commands.report import report_bag

    report_bag(bag, reference, output, export, section or (), namespace=namespace, as_json=json)


@app.command()
def dashboard(
    run: Annotated[
        Path | None,
        typer.Argument(help="run or bag; none: the running cell of this ROS domain", metavar="RUN", show_default=False),
    ] = None,
    port: Annotated[int, typer.Option(help="port on this computer; 0: any that is free", min=0, max=65535)] = 8750,
    token: Annotated[
        str | None, typer.Option(help="of the address, to keep it the same  [default: a random one]", metavar="TEXT")
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(help="also write time, pose and forces of a running cell as text of 12 columns", metavar="FILE"),
    ] = None,
    namespace: Annotated[
        str | None, typer.Option("--namespace", help="cell, where there are several", metavar="NAME")
    ] = None,
    json: Json = False,
) -> None:
    """Show a running cell, with pause and stop, or a recorded part in the browser; until Ctrl-C."""
    from isf_cell.commands.dashboard import show_cell, show_run

    if run is None:
        show_cell(port, token or "", log, namespace=namespace, as_json=json)
    else:
        show_run(run, port, token or "", log, namespace=namespace, as_json=json)


@app.command()
def play(
    context: typer.Context,
    bag: Annotated[Path, typer.Argument(help="bag, or folder of a run", metavar="BAG", show_default=False)],
    rate: Annotated[float, typer.Option(help="of time: 2 is twice as fast")] = 1.0,
    contour: Annotated[
        int | None, typer.Option("--from", help="contour to begin with, counted from 1", metavar="CONTOUR", min=1)
    ] = None,
    topic: Annotated[
        list[str] | None, typer.Option("--topic", help="topic to play; again for each  [default: all]", metavar="NAME")
    ] = None,
    remap: Annotated[
        list[str] | None,
        typer.Option("--remap", "-r", help="topic that is published by another name", metavar="FROM:=TO"),
    ] = None,
    clock: Annotated[float, typer.Option(help="Hz of /clock with the time of the recording, if it holds none")] = 0.0,
    paused: Annotated[
        bool, typer.Option("--paused", help="wait at the first message: player/step, player/pause")
    ] = False,
    delay: Annotated[float, typer.Option(help="s before the first message, for subscribers", min=0.0)] = 1.0,
    into: Annotated[
        str | None,
        typer.Option(
            help="live node that gets what it listens to and is compared with the record: force_ctrl or springback; "
            "started where none runs",
            metavar="NODE",
        ),
    ] = None,
    param: Annotated[
        list[str] | None,
        typer.Option(help="parameter of the node that is started; again for each", metavar="NAME:=VALUE"),
    ] = None,
    base: Annotated[
        Path | None,
        typer.Option(help="folder that paths in the recorded job refer to, with --into  [default: the recorded one]"),
    ] = None,
    namespace: Namespace = None,
    json: Json = False,
) -> None:
    """Publish a bag into the ROS graph, as it was recorded and when."""
    from isf_cell.commands.play import PlayOptions, play_bag, play_into_node

    options = PlayOptions(rate, contour, topic or (), remap or (), clock, paused, delay, namespace)
    if into is None:
        refuse(context, ["--param", "--base"], "is of the node that --into names", "add --into NODE, or leave it out")
        play_bag(bag, options, as_json=json)
    else:
        play_into_node(bag, into, options, param or (), base, as_json=json)


@app.command()
def replay(
    run: Annotated[Path, typer.Argument(help="folder of a run, or its bag", metavar="RUN", show_default=False)],
    what_if: Annotated[
        list[str] | None,
        typer.Option(
            help="another value, such as force.integral_gain=80 or springback.gain=0.8; again for each",
            metavar="NAME=VALUE",
        ),
    ] = None,
    replant: Annotated[
        bool | None,
        typer.Option(
            "--replant/--no-replant",
            help="form the part again on the simulated machine  [default: simulated parts with a --what-if]",
        ),
    ] = None,
    from_contour: Annotated[
        int | None,
        typer.Option(
            "--from",
            help="form a simulated part again, the contours before this one as recorded, from it on with the --what-if",
            metavar="CONTOUR",
        ),
    ] = None,
    base: Annotated[
        Path | None, typer.Option(help="folder that paths in the recorded job refer to  [default: the recorded one]")
    ] = None,
    output: Output = None,
    namespace: Namespace = None,
    json: Json = False,
) -> None:
    """Decide a recorded part again, with the same or with other parameters, and compare."""
    from isf_cell.commands.replay import replay_run

    replay_run(run, what_if or (), output, base, replant, namespace=namespace, from_contour=from_contour, as_json=json)


@app.command()
def compare(
    first: Annotated[
        Path,
        typer.Argument(
            help="shape that is looked at: a run or bag, a mesh or CAD file, a job (its CAD), a cloud of points",
            metavar="A",
            show_default=False,
        ),
    ],
    second: Annotated[Path, typer.Argument(help="shape that it is compared with", metavar="B", show_default=False)],
    unit: Annotated[
        str | None, typer.Option(help="unit of meshes and PLY clouds that carry none: mm, cm, m or in")
    ] = None,
    align: Annotated[
        str, typer.Option(help="clamp: both as they are, in the frame of the clamp; fit: A is moved onto B as a whole")
    ] = "clamp",
    tolerance: Annotated[
        list[float] | None, typer.Option(help="mm; again for each  [default: 0.1, 0.2, 0.3]", metavar="MM")
    ] = None,
    inside: Annotated[
        list[str] | None,
        typer.Option(
            help="only points in this shape, in plan, mm: circle:X,Y,R box:X0,Y0,X1,Y1 polygon:FILE.csv; again for "
            "each, points in any of them count",
            metavar="SHAPE",
        ),
    ] = None,
    outside: Annotated[
        list[str] | None,
        typer.Option(help="only points that are not in this shape; again for each", metavar="SHAPE"),
    ] = None,
    region: Annotated[
        list[str] | None,
        typer.Option(
            help="only points in this region of B, a job or a run: wall, base, wall_and_base, rim or flange; again "
            "for each",
            metavar="NAME",
        ),
    ] = None,
    output: Output = None,
    namespace: Namespace = None,
    json: Json = False,
) -> None:
    """Distance of one shape from another, along the normal: numbers, map, table."""
    from isf_cell.commands.compare import Masks, compare_shapes

    masks = Masks(tuple(inside or ()), tuple(outside or ()), tuple(region or ()))
    compare_shapes(first, second, unit, align, tolerance or None, output, masks, namespace=namespace, as_json=json)


@app.command()
def learn(
    context: typer.Context,
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="run or bag folders, oldest first; of one part without --surfaces; with --scan one, or the job",
            metavar="RUN...",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="correction file; added to when it exists")],
    scan: Annotated[
        Path | None,
        typer.Option(
            help="scan of the part from a bench, in place of that of RUN: .ply, .npz or .csv cloud, .stl or other mesh",
            metavar="FILE",
        ),
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="unit of a mesh or PLY cloud of --scan that carries none: mm, cm, m or in")
    ] = None,
    align: Annotated[
        str | None,
        typer.Option(
            help="clamp: --scan lies in the frame of the clamp; fit: it is moved onto the part  [default: fit of a "
            "part out of the clamp, else clamp]"
        ),
    ] = None,
    released: Annotated[
        bool, typer.Option("--released", help="--scan is of the part out of the clamp, trimmed or not")
    ] = False,
    release_of: Annotated[
        Path | None,
        typer.Option(
            help="run of isf simulate --release: --scan is of a part out of the clamp, and what that of RUN moved by "
            "when it was released is taken out  [default: it is corrected, too]",
            metavar="RUN",
        ),
    ] = None,
    as_planned: Annotated[
        bool, typer.Option("--as-planned", help="the part of --scan was formed without a correction; of a job")
    ] = False,
    base: Annotated[
        Path | None, typer.Option(help="folder that paths in the recorded jobs refer to  [default: the recorded one]")
    ] = None,
    surfaces: Annotated[
        bool,
        typer.Option("--surfaces", help="from runs of different parts: accuracy surfaces for parts not formed yet"),
    ] = False,
    json: Json = False,
) -> None:
    """Learn the correction of the next part from the shapes of parts formed before."""
    from isf_cell.commands.learn import Bench, is_job, learn_runs, learn_scan, learn_surfaces

    if surfaces:
        refuse(context, ["--base"], "accuracy surfaces need no file that a job names", "leave it out")
        refuse(context, ["--scan"], "accuracy surfaces are learned from runs alone", "leave it out")
    if scan is None:
        of_scan = ["--unit", "--align", "--released", "--release-of", "--as-planned"]
        refuse(context, of_scan, "is of --scan", "add --scan FILE, or leave it out")
    if surfaces:
        learn_surfaces(runs, output, as_json=json)
        return
    if scan is not None:
        if len(runs) > 1:
            refuse(context, ["--scan"], "is of one part", "name the run or the job of that part alone")
        if is_job(runs[0]):
            refuse(context, ["--base"], "the paths of a job are relative to it", "leave it out")
        else:
            refuse(context, ["--as-planned"], "a run tells its corrections", "leave it out, or name the job")
        bench = Bench(scan, unit, align, released, release_of, as_planned)
        learn_scan(runs[0], bench, output, base, as_json=json)
        return
    learn_runs(runs, output, base, as_json=json)


@app.command()
def tryout(
    job: Job,
    correction: Annotated[
        str | None, typer.Option("--correction", help="method of the first part, auto, or none  [default: the job's]")
    ] = None,
    steps: Annotated[int, typer.Option(help="parts after the probes, at most, of either kind", min=1, max=50)] = 6,
    variants: Annotated[
        str, typer.Option(help="plants that the correction is for, with commas", metavar="N,...")
    ] = "0",
    check: Annotated[
        str, typer.Option(help='plants on which the result is formed again; "" for none', metavar="N,...")
    ] = "21,22",
    judge: Annotated[
        str,
        typer.Option(
            "--check-sheet",
            help="sheet on which the result is formed again  [default: shell, of a try-out on shell or fast "
            "shell_coarse: other cells, another tool speed]",
        ),
    ] = "",
    alternatives: Annotated[
        list[str] | None,
        typer.Option(
            "--or",
            help='another way to hold or form the sheet, such as "path: {support: on_blank}"; the best one is gone on '
            "with; may be given again",
            metavar="FIELDS",
        ),
    ] = None,
    seed: Seed = 0,
    sheet: Annotated[str, typer.Option("--sheet", help=_SHEETS)] = "shell_coarse",
    jobs: Annotated[
        int | None, typer.Option(help="parts at a time  [default: one per processor]", min=1, max=64)
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="folder; goes on where it was  [default: runs/tryout-NAME]", metavar="DIR"),
    ] = None,
    json: Json = False,
) -> None:
    """Find the correction of a part on the simulated elasto-plastic sheet, before the first real one."""
    from isf_cell.commands.tryout import Tryout, try_out

    of_correction, of_check = (numbers(text, name) for text, name in ((variants, "--variants"), (check, "--check")))
    if not of_correction:
        raise IsfError(ErrorCode.FILE_FIELD, "names no variant", where="--variants", advice="0 is the nominal plant")
    count = jobs or len(os.sched_getaffinity(0))
    kind, ways = sheet_kind(sheet, "--sheet") or "shell_coarse", tuple(alternatives or ())
    checked_on = sheet_kind(judge, "--check-sheet")
    wanted = Tryout(job, kind, steps, of_correction, of_check, seed, count, correction, ways, checked_on)
    try_out(wanted, output, as_json=json)


@app.command()
def campaign(
    file: Annotated[
        Path, typer.Argument(help="campaign file (YAML): jobs, methods, variants", metavar="FILE", show_default=False)
    ],
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", help="parts at a time  [default: one per processor]", min=1, max=256)
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="folder; goes on where it was  [default: runs/campaign-NAME]", metavar="DIR"
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Simulate jobs by methods on variants of the plant, on all cores: one table (CSV, Parquet) and one page."""
    from isf_cell.commands.campaign import run_campaign

    run_campaign(file, output, jobs or len(os.sched_getaffinity(0)), as_json=json)


@app.command()
def tune(
    context: typer.Context,
    job: Job,
    stiffness: Annotated[float | None, typer.Option(help="contact stiffness in N/um  [default: the rig's]")] = None,
    delay: Annotated[float, typer.Option(help="delay in ms beyond filter and hold")] = 0.0,
    noise: Annotated[float, typer.Option(help="noise of the load cell in % of the force")] = 1.0,
    gain: Annotated[float | None, typer.Option(help="loop gain in 1/s  [default: the controller's]")] = None,
    legs: Annotated[bool, typer.Option("--legs", help="the position loops of the rig's legs instead")] = False,
    output: Output = None,
    json: Json = False,
) -> None:
    """Try the force loop of a job on a contact model, or the loops of its rig's legs: responses and pictures."""
    if legs:
        of_force = ["--stiffness", "--delay", "--noise", "--gain"]
        refuse(context, of_force, "is of the force loop; those of the legs stand in the rig file", "leave it out")
        from isf_cell.commands.tune_legs import tune_legs

        tune_legs(job, output, as_json=json)
        return
    from isf_cell.commands.tune import tune_job

    tune_job(job, output, stiffness=stiffness, delay=delay, noise=noise, loop_gain=gain, as_json=json)


@app.command()
def calibrate_cell(
    loads: Annotated[Path, typer.Argument(help="table of known loads and readings (CSV)", metavar="FILE")],
    limit: Annotated[float | None, typer.Option(help="use only loads up to this many N")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="file for the piece of a rig file")] = None,
    json: Json = False,
) -> None:
    """Fit the matrix of a load cell, or the gains of its channels, to known loads; reports residuals."""
    from isf_cell.commands.calibrate_cell import calibrate_file

    calibrate_file(loads, limit, output, as_json=json)


@app.command()
def identify(
    job: Annotated[Path | None, typer.Argument(help="job file (YAML); or --rig", metavar="JOB")] = None,
    property: Annotated[
        str | None, typer.Option("--property", "-p", help="compliance, stiffness, servo or signs", show_default=False)
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(help="rig (name or file) instead of a job: a small cone is formed on it", metavar="RIG"),
    ] = None,
    dial: Annotated[
        Path | None, typer.Option(help="table (CSV) of forces and dial readings at the tips: compliance from these")
    ] = None,
    tool: Annotated[int, typer.Option(help="1 (upper) or 2 (lower)", min=1, max=2)] = 1,
    repeats: Annotated[int, typer.Option(help="visits of each place", min=1, max=20)] = 2,
    place: Annotated[
        list[str] | None, typer.Option(help='"x y z" in mm, again for each place  [default: a set]', metavar="PLACE")
    ] = None,
    max_force: Annotated[float, typer.Option(help="N that no load cell may exceed")] = 600.0,
    contours: Annotated[int | None, typer.Option(help="contours formed first, for a wall  [default: 70 %]")] = None,
    variant: Variant = 0,
    seed: Seed = 0,
    cell: Annotated[
        bool, typer.Option("--cell", help="on the running cell of this ROS domain, armed, as it is")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="rig file to write  [default: in runs/]", metavar="FILE")
    ] = None,
    json: Json = False,
) -> None:
    """Identify compliance, contact stiffness, servo or load cells with the tools or a dial; writes a rig file."""
    from isf_cell.commands.identify import identify_machine

    identify_machine(
        job,
        rig,
        property,
        dial,
        output,
        tool=tool,
        repeats=repeats,
        places=tuple(place or ()),
        max_force=max_force,
        contours=contours,
        variant=variant,
        seed=seed,
        cell=cell,
        as_json=json,
    )


@app.command()
def faults(
    short: Annotated[
        bool, typer.Option("--short", help="the quickest kinds, one fault of each, one of them resumed")
    ] = False,
    count: Annotated[int, typer.Option("--faults", help="faults of each kind", min=1, max=1000)] = 5,
    kinds: Annotated[
        list[str] | None,
        typer.Option("--kinds", help='only kinds that begin so, such as "kill"; again for each', metavar="NAME"),
    ] = None,
    seed: Seed = 0,
    resume: Annotated[bool, typer.Option(help="go on with every part that a fault has ended, and compare it")] = True,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="folder; goes on where it was  [default: runs/faults-TIME]", metavar="DIR"),
    ] = None,
    json: Json = False,
) -> None:
    """Disturb real cells of the simulated machine in every known way: a row for each kind, with the goals it misses."""
    from isf_cell.commands.faults import run_faults

    run_faults(output, kinds or (), short=short, faults=count, seed=seed, resume=resume, as_json=json)


@app.command()
def doctor(json: Json = False) -> None:
    """Check the installation: what works, what is missing, and what to do about it."""
    from isf_cell.commands.doctor import examine

    examine(as_json=json)


@app.command()
def version() -> None:
    """Print the version."""
    print(__version__)


def main() -> None:
    """Entry point; ends with a code of :class:`isf_cell.commands.exit_codes.Exit`, never with a traceback."""
    as_json = "--json" in sys.argv
    if sys.argv[1:2] not in (["run"], ["record"]):  # these become the process of a node
        keep_for_results()
    try:
        app(prog_name="isf")
    except IsfError as error:
        terminal.show_error(error, as_json=as_json and not isinstance(error, ReportedError))
        sys.exit(exit_for(error.code))
    except KeyboardInterrupt:
        terminal.show_error(IsfError(ErrorCode.CANCELLED, "stopped by the operator"), as_json=as_json)
        sys.exit(Exit.CANCELLED)
    except Exception as fault:  # the last line of defence: a sentence instead of a traceback
        if os.environ.get("ISF_TRACEBACK"):
            raise
        coded = terminal.unexpected(fault)
        terminal.show_error(coded, as_json=as_json)
        sys.exit(exit_for(coded.code))


if __name__ == "__main__":
    main()
