"""``isf identify``: compliance, contact stiffness, servo or signs of the load cells, measured with the tools.

Without a job a job for the rig alone is made: what identification forms when no part is named.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.files.yaml_file import find_named
from isf_identify.identification import Finding
from isf_identify.rig_piece import rig_reference
from isf_identify.settings import IdentifySettings, Property
from isf_planner.part_library import PARTS, part_mesh

from isf_cell.commands import terminal
from isf_cell.commands.exit_codes import ReportedError
from isf_cell.commands.identify_dial import identify_dial
from isf_cell.commands.run_folder import run_folder

NAMES = {
    "compliance": Property.TOOL_COMPLIANCE,
    "stiffness": Property.CONTACT_STIFFNESS,
    "servo": Property.SERVO_RESPONSE,
    "signs": Property.LOAD_CELL_SIGNS,
}

_ROWS: dict[Property, tuple[str, str, float, tuple[str, ...]]] = {
    Property.TOOL_COMPLIANCE: ("compliance", "µm/N", 1e6, ("x", "y", "z")),
    Property.CONTACT_STIFFNESS: ("contact stiffness", "N/µm", 1e-6, ("K_c",)),
    Property.SERVO_RESPONSE: ("servo", "Hz", 1.0, ("-3 dB",)),
    Property.LOAD_CELL_SIGNS: (
        "load cells",
        "1 right, -1 turned, 0 other axis",
        1.0,
        ("tool_1 Fx", "tool_1 Fy", "tool_1 Fz", "tool_2 Fx", "tool_2 Fy", "tool_2 Fz"),
    ),
}


def identify_machine(
    job: Path | None,
    rig: str | None,
    name: str | None,
    dial: Path | None,
    output: Path | None,
    *,
    tool: int,
    repeats: int,
    places: tuple[str, ...],
    max_force: float,
    contours: int | None,
    variant: int,
    seed: int,
    cell: bool,
    as_json: bool,
) -> None:
    """Identify property ``name`` of the machine of ``job`` or ``rig``, or compliances by ``dial``; raises IsfError."""
    if (job is None) == (rig is None) and not (cell and job is None and rig is None):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "a job or a rig is needed, not both",
            where="identify",
            advice="isf identify JOB ..., or isf identify --rig ren2018 ...",
        )
    if dial is not None:
        if name not in (None, "compliance") or cell:
            raise IsfError(ErrorCode.FILE_FIELD, "a dial indicator measures compliances only", where="--dial")
        below = rig_name(rig) if rig is not None else rig_reference(_job(job, None, Path()))
        with _files(output, "identify-dial") as (piece, _):
            identify_dial(dial, below, piece, as_json=as_json)
        return
    if name is None or name not in NAMES:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"there is no property '{name}'" if name else "no property was requested",
            where="--property",
            advice="one of " + ", ".join(NAMES),
        )
    settings = IdentifySettings.of(NAMES[name], tool, repeats, [c for text in places for c in _place(text)], max_force)
    with _files(output, f"identify-{name}") as (piece, picture):
        found = _found(job, rig, name, settings, contours=contours, variant=variant, seed=seed, cell=cell)
        data = _written(found, settings, piece, picture)
    failure = IsfError(found.code, found.message, where="load cells") if found.code else None
    if failure is not None:
        data["error"] = terminal.error_data(failure)
    if as_json:
        terminal.print_json(data)
    _show(found, settings)
    terminal.say(f"rig file {piece}" + (f"\npicture  {picture}" if data["picture"] else ""))
    if failure is not None:
        raise ReportedError(failure)


def _found(
    job: Path | None,
    rig: str | None,
    name: str,
    settings: IdentifySettings,
    *,
    contours: int | None,
    variant: int,
    seed: int,
    cell: bool,
) -> Finding:
    """What is measured, in a running cell or on the simulated machine; raises IsfError, also where nothing is found."""
    with terminal.part_progress(f"identify {name}") as shown:

        def progress(phase: str, share: float) -> None:
            shown.phase(f"{phase} ({100 * share:.0f} %)")

        if cell:
            from isf_cell.run.identify_client import identify_in_cell

            found = identify_in_cell(settings, progress)
        else:
            from isf_cell.run.identify_run import identify

            with TemporaryDirectory() as folder:
                job_file = _job(job, rig, Path(folder))
                found = identify(job_file, settings, contours=contours, variant=variant, seed=seed, progress=progress)
    if not len(found.value):
        raise IsfError(found.code, found.message)
    return found


def _job(job: Path | None, rig: str | None, folder: Path) -> JobFile:
    """The job, or one for ``rig`` with its mesh in ``folder``."""
    if job is not None:
        return load_job(job)
    return rig_job(rig or "", folder)


def _place(text: str) -> list[float]:
    """x, y, z in m from "x y z" in mm."""
    try:
        numbers = [1e-3 * float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise IsfError(
            ErrorCode.FILE_FIELD, f"'{text}' is no place", where="--place", advice='such as "10 0 -4", in mm'
        )
    return numbers


@contextmanager
def _files(output: Path | None, name: str) -> Iterator[tuple[Path, Path]]:
    """Rig file and picture, in a folder of their own where ``output`` names none; raises IsfError FILE_NOT_WRITABLE."""
    if output is None:
        with run_folder(None, name) as folder:
            yield folder / "rig.yaml", folder / "identified.png"
    elif not output.parent.is_dir():
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, "its folder does not exist", where=str(output))
    else:
        yield output, output.with_suffix(".png")


def _written(found: Finding, settings: IdentifySettings, piece: Path, picture: Path) -> dict[str, Any]:
    """Write the files; returns the result for ``--json``."""
    text = found.piece
    if "based_on" in text:  # a whole rig file wants a name, a piece has none
        name = json.dumps(piece.stem, ensure_ascii=False)
        text = text.replace("based_on:", f"name: {name}\nbased_on:", 1)
    try:
        piece.write_text(text, encoding="utf-8")
    except OSError as error:
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, str(error), where=str(piece)) from None
    drawn = None
    if found.fit is not None:
        from isf_identify.figures import draw_finding

        drawn = str(draw_finding(found.fit, picture))
    return {
        "property": settings.property.name,
        "tool": settings.tool,
        "value": found.value.tolist(),
        "uncertainty": found.uncertainty.tolist(),
        "notes": list(found.notes),
        "rig": str(piece),
        "picture": drawn,
    }


def _show(found: Finding, settings: IdentifySettings) -> None:
    title, unit, scale, rows = _ROWS[settings.property]
    of = f" of tool_{settings.tool}" if settings.property in (Property.TOOL_COMPLIANCE, Property.SERVO_RESPONSE) else ""
    heads = (f"value [{unit}]", f"standard deviation [{unit}]")
    if settings.property == Property.LOAD_CELL_SIGNS:
        heads = (unit, "standard deviation")
    table = terminal.table_of(title + of, "", *heads)
    for row, value, deviation in zip(rows, found.value, found.uncertainty, strict=True):
        known = np.isfinite(value)
        table.add_row(
            row, f"{scale * value:.4g}" if known else "not observable", f"{scale * deviation:.2g}" if known else "-"
        )
    terminal.console.print(table)
    for note in found.notes:
        terminal.say(f"  {note}")


_JOB = """\
name: identification
part: {{mesh: identification.stl, unit: mm}}
process: DSIF
rig: {rig}
sheet: {{material: AA5754-O, thickness: 1.0 mm}}
tool_1: {{radius: 5 mm}}
tool_2: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
control: {{support_force: 120 N, engage_depth: 2 mm}}
springback: {{method: none}}
"""


def rig_job(rig: str, folder: Path) -> JobFile:
    """Job on ``rig`` (a name, or a file relative to the present folder), its mesh written to ``folder``.

    Raises IsfError for the rig.
    """
    part = part_mesh(PARTS["cone"](radius=0.016, angle=np.pi / 4.0, depth=0.005, entry=0.004, floor=0.004))
    trimesh.Trimesh(part.vertices * 1e3, part.faces, process=False).export(folder / "identification.stl")
    named = json.dumps(rig_name(rig), ensure_ascii=False)  # a YAML string, whatever is in the path
    return JobFile(_JOB.format(rig=named), folder, "the job of --rig")


def rig_name(rig: str) -> str:
    """``rig`` as a rig file may be based on it from anywhere: its name, or the absolute path of its file."""
    path = find_named("rigs", rig, Path.cwd())
    return str(path.resolve()) if rig.endswith((".yaml", ".yml")) else rig
