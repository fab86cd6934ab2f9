"""The ``isf springback`` commands: what they are called with; the work is in :mod:`isf_cell.commands.springback`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from isf_cell.commands.arguments import Job, Json, Output, Seed, Variant

app = typer.Typer(
    help="Springback of a part before it is formed: predict, database, control points, methods side by side.",
    no_args_is_help=True,
)


@app.command()
def predict(
    job: Job,
    force: Annotated[list[float] | None, typer.Option(help="load in N; may be given several times")] = None,
    depth: Annotated[float | None, typer.Option(help="depth in mm  [default: the last contour]")] = None,
    direction: Annotated[str, typer.Option(help="direction of the load: push, x or y")] = "push",
    json: Json = False,
) -> None:
    """Deflection of the partly formed sheet at the control points of one depth."""
    from isf_cell.commands.springback import predict_part

    predict_part(job, force or [], depth, direction, as_json=json)


@app.command(name="control-points")
def control_points(job: Job, output: Output = None, json: Json = False) -> None:
    """Where springback is computed: picture and table, with k-means and k-medoids beside it."""
    from isf_cell.commands.springback import show_control_points

    show_control_points(job, output, as_json=json)


@app.command()
def database(
    job: Job,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="database file  [default: the user's cache]", metavar="FILE")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="processes; 0: this one  [default: one per processor]", min=0)
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="address of a dask.distributed scheduler", metavar="ADDRESS")
    ] = None,
    json: Json = False,
) -> None:
    """Compute the load-displacement database of a part; stopped and started again it goes on where it was."""
    from isf_cell.commands.springback import compute_database

    compute_database(job, output, workers, scheduler, as_json=json)


@app.command()
def calibrate(
    job: Job,
    curve: Annotated[
        Path | None,
        typer.Argument(
            help="CSV with force_N and displacement_mm of a push on the flat sheet; left out: the simulated machine",
            show_default=False,
        ),
    ] = None,
    place: Annotated[tuple[float, float], typer.Option("--at", help="x and y of the push in mm")] = (0.0, 0.0),
    variant: Variant = 0,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Edge condition of the clamp from one push on the flat sheet."""
    from isf_cell.commands.springback import calibrate_clamp

    calibrate_clamp(job, curve, place, variant, seed, as_json=json)


@app.command()
def compare(
    job: Job,
    methods: Annotated[str, typer.Option(help="names, separated by commas")] = "none,analytic,elastic",
    variant: Variant = 0,
    seed: Seed = 0,
    output: Output = None,
    json: Json = False,
) -> None:
    """Form a part on the simulated machine with several methods: table and picture."""
    from isf_cell.commands.springback_compare import compare_methods

    compare_methods(
        job, [name.strip() for name in methods.split(",") if name.strip()], variant, seed, output, as_json=json
    )
