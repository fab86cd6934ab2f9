"""Arguments of the commands for an operator at a running cell: mode, pause, go_on, move_to, jog, zero."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from isf_cell.commands.arguments import Json

app = typer.Typer()

Tool = Annotated[int, typer.Option("--tool", help="1 (upper) or 2 (lower)", min=1, max=2)]
Speed = Annotated[float, typer.Option("--speed", help="mm/s", min=0.01, max=200.0)]
NEGATIVE = {"ignore_unknown_options": True}
"""A coordinate may begin with a minus."""


@app.command()
def mode(
    name: Annotated[
        str | None,
        typer.Argument(help="automatic, manual, set-up or simulation; none: tell it", metavar="MODE"),
    ] = None,
    job: Annotated[
        Path | None,
        typer.Argument(
            help="job whose rig, sheet and tools are meant  [default: that of the last part]", metavar="JOB"
        ),
    ] = None,
    new_blank: Annotated[bool, typer.Option("--new-blank", help="simulated machine: clamp a fresh sheet")] = False,
    json: Json = False,
) -> None:
    """Tell or change what the running cell permits: forming, moving by hand, setting up, checking programs."""
    from isf_cell.commands.hand import change_mode

    change_mode(name, job, new_blank=new_blank, as_json=json)


@app.command()
def pause(json: Json = False) -> None:
    """Let the part that the running cell forms wait after the present contour."""
    from isf_cell.commands.hand import pause_part

    pause_part(True, as_json=json)


@app.command("go-on")
def go_on(json: Json = False) -> None:
    """Let a part go on that waits: after `isf pause`, M0 of a program or hold_after of a job."""
    from isf_cell.commands.hand import pause_part

    pause_part(False, as_json=json)


@app.command("move-to", context_settings=NEGATIVE)
def move_to(
    x: Annotated[float, typer.Argument(help="mm", metavar="X")],
    y: Annotated[float, typer.Argument(help="mm", metavar="Y")],
    z: Annotated[float, typer.Argument(help="mm", metavar="Z")],
    tool: Tool = 1,
    speed: Speed = 10.0,
    system: Annotated[
        str | None, typer.Option("--in", help="work coordinates, G54 to G57  [default: frame sheet]", metavar="G54")
    ] = None,
    json: Json = False,
) -> None:
    """Move one tool of the running cell straight to a position; Ctrl-C stops it, and so does the end of the command."""
    from isf_cell.commands.hand import move_tool

    move_tool(tool, (x, y, z), speed, system, as_json=json)


@app.command(context_settings=NEGATIVE)
def jog(
    steps: Annotated[
        list[str] | None,
        typer.Argument(help="+x -x +y -y +z -z, one after the other; none: by keys", metavar="STEP..."),
    ] = None,
    tool: Tool = 1,
    increment: Annotated[float, typer.Option("--increment", help="length of a step, mm", min=0.001, max=50.0)] = 1.0,
    speed: Speed = 10.0,
    json: Json = False,
) -> None:
    """Move one tool of the running cell by steps, named or by keys."""
    from isf_cell.commands.hand import jog_tool

    jog_tool(tool, tuple(steps or ()), increment, speed, as_json=json)


@app.command()
def zero(
    system: Annotated[str, typer.Argument(help="G54, G55, G56 or G57", metavar="SYSTEM")],
    tool: Tool = 1,
    axes: Annotated[str, typer.Option("--axes", help="coordinates that are set, such as xy")] = "xyz",
    json: Json = False,
) -> None:
    """Set a work offset of the cell where a tool is: it then reads zero there, in programs too."""
    from isf_cell.commands.hand import set_zero

    set_zero(system, tool, axes, as_json=json)
