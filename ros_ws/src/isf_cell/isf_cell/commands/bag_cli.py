"""The ``isf bag`` commands: what they are called with; the work is in :mod:`isf_cell.commands.bag`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from isf_cell.commands.arguments import Json, Namespace

app = typer.Typer(
    help="What is in a bag: a short summary, its topics and contours as tables; and a bag made whole again.",
    no_args_is_help=True,
)

Bag = Annotated[Path, typer.Argument(help="bag, or folder of a run", metavar="BAG", show_default=False)]


@app.command()
def info(bag: Bag, namespace: Namespace = None, json: Json = False) -> None:
    """Part, duration and topics of a bag."""
    from isf_cell.commands.bag import show_bag

    show_bag(bag, namespace=namespace, as_json=json)


@app.command()
def tables(
    bag: Bag,
    output: Annotated[Path, typer.Option("--output", "-o", help="folder for the files", metavar="DIR")],
    form: Annotated[
        list[str] | None,
        typer.Option("--format", help="csv, npz or parquet; again for each  [default: all, parquet with pyarrow]"),
    ] = None,
    topic: Annotated[
        list[str] | None, typer.Option("--topic", help="topic to write; again for each  [default: all]", metavar="NAME")
    ] = None,
    namespace: Namespace = None,
    json: Json = False,
) -> None:
    """Write a table per topic, and of the part: a row per contour, per contour point and per control tick."""
    from isf_cell.commands.bag import write_bag_tables

    write_bag_tables(bag, output, form, topic, namespace=namespace, as_json=json)


@app.command()
def repair(
    bag: Bag,
    output: Annotated[Path, typer.Option("--output", "-o", help="the new bag; must not exist", metavar="DIR")],
    json: Json = False,
) -> None:
    """Write what can be read of a bag as a new one: with index and metadata, in one file."""
    from isf_cell.commands.bag import repair_bag

    repair_bag(bag, output, as_json=json)
