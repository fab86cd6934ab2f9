"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from isf_cell.options import LARGEST_NUMBER

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
Json = Annotated[bool, typer.Option("--json", help="print one JSON object on stdout")]
