"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from isf_core.errors import ErrorCode, IsfError
from isf_core.simulated_sheet import LARGEST_NUMBER

Job = Annotated[Path, typer.Argument(help="job file (YAML)", metavar="JOB", show_default=False)]
Variant = Annotated[
    int,
    typer.Option(
        "--variant",
        "--world",
        help="simulated plant: 0 nominal, others variants of it, 101-120 sealed",
        min=0,
        max=LARGEST_NUMBER,
    ),
]
Seed = Annotated[int, typer.Option("--seed", help="seed of sensor noise and of the variant", min=0, max=LARGEST_NUMBER)]
Output = Annotated[
    Path | None, typer.Option("--output", "-o", help="folder for the results  [default: runs/NAME-TIME]", metavar="DIR")
]
Namespace = Annotated[
    str | None, typer.Option("--namespace", help="cell that is meant, where a bag holds several", metavar="NAME")
]
Json = Annotated[bool, typer.Option("--json", help="print one JSON object on stdout")]


def given(context: typer.Context, values: Mapping[str, Any]) -> dict[str, Any]:
    """Those of ``values``, by the names of their options, that are on the command line."""
    names = {option: item.name or "" for item in context.command.params for option in item.opts}
    sources = {name: context.get_parameter_source(names.get(name, name.lower())) for name in values}
    return {name: values[name] for name, source in sources.items() if source is not None and source.name in _GIVEN}


_GIVEN = ("COMMANDLINE", "ENVIRONMENT")


def refuse(context: typer.Context, options: Sequence[str], what: str, advice: str) -> None:
    """Refuse ``options`` that are on the command line although they have no effect beside the others.

    Raises IsfError FILE_FIELD: ``what`` says why, ``advice`` what to do.
    """
    if found := given(context, dict.fromkeys(options)):
        raise IsfError(ErrorCode.FILE_FIELD, what, where=", ".join(found), advice=advice)


def numbers(text: str, where: str) -> tuple[int, ...]:
    """Variants with commas between; raises IsfError FILE_FIELD for anything else."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not all(part.isdecimal() and int(part) <= LARGEST_NUMBER for part in parts):
        raise IsfError(
            ErrorCode.FILE_FIELD, f"'{text}' is not a list of variants", where=where, advice="such as 0,21,22"
        )
    return tuple(dict.fromkeys(map(int, parts)))
