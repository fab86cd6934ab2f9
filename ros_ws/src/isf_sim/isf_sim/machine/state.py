"""A simulated machine saved to one file and taken up again: sheet, axes, load cells, events, generators, time.

The file is a numpy archive of plain arrays with a header in JSON: format, version, digest of the sources of the plant,
job, digests of its rig and material, variant, seed, blank and the structure of the state. A machine taken up goes on
bit by bit as the saved one would have gone on, with the same software; a file saved by another plant, or with another
rig or material, is refused.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import Event, EventKind
from isf_core.files.archive import read_archive, write_archive
from isf_core.files.bounded import parse_json, reason
from isf_core.files.job import JobFile
from isf_core.object_state import Encoder, StateMismatchError, differing

from isf_sim.machine.simulated_machine import MachineState, SimulatedMachine
from isf_sim.plant_constants import PlantConstants
from isf_sim.shell.shell_assembly import SupportPoints

_SOURCES = Path(__file__).resolve().parents[1]

FORMAT, VERSION = "isf-machine-state", 13


def save_machine(machine: SimulatedMachine, path: str | Path) -> Path:
    """Write ``machine`` to ``path`` as it is; returns the path.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE
    """
    path = Path(path)
    encoder = _encoder()
    state = {name: encoder.encode(value) for name, value in vars(machine.state()).items()}
    header = {
        "format": FORMAT,
        "version": VERSION,
        "software": __version__,
        "plant": plant_digest(),
        "job": machine.job_file.text,
        "base": str(machine.job_file.base),
        "files": file_digests(machine.job_file),
        "variant": machine.variant_number,
        "seed": machine.seed,
        "blank": machine.blank,
        "sheet": machine.sheet_kind,
        "constants": dataclasses.asdict(machine.plant_constants),
        "state": state,
    }
    arrays: dict[str, Any] = {f"a{k}": array for k, array in enumerate(encoder.arrays)}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    write_archive(path, arrays, compressed=True)
    return path


def load_machine(path: str | Path) -> SimulatedMachine:
    """The machine of a file as :func:`save_machine` writes it.

    Raises
    ------
    IsfError : FILE_NOT_FOUND; FILE_SYNTAX (not such a file, damaged, other version or plant, or another rig or
        material); as JobFile for the job in it
    """
    path = Path(path)
    header, arrays = _read(path)
    job_file = JobFile(header["job"], Path(header["base"]), f"job in {path.name}")
    try:
        machine = SimulatedMachine(
            job_file,
            variant=header["variant"],
            seed=header["seed"],
            blank=header["blank"],
            constants=PlantConstants(**header["constants"]),
            sheet=header["sheet"],
        )
        _check_files(header["files"], machine.job_file, path)
        fresh, encoder = vars(machine.state()), _encoder()
        if set(header["state"]) != set(fresh):
            raise StateMismatchError(f"a machine has other fields than the file ({differing(header['state'], fresh)})")
        saved = {name: encoder.decode(code, arrays, fresh[name]) for name, code in header["state"].items()}
        machine.take_up(MachineState(**saved))
    except (StateMismatchError, KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"does not fit this software: {error}",
            where=str(path),
            advice=f"it was saved by version {header.get('software', '?')}, this is {__version__}",
        ) from error
    return machine


def file_digests(job_file: JobFile) -> dict[str, str]:
    """Digests of what the files of rig, with its error maps, and material of a job say; their sources left out."""
    rig, material = (
        hashlib.sha256(model.model_dump_json(exclude={"provenance"}).encode())
        for model in (job_file.rig, job_file.material)
    )
    for tool in (job_file.rig.tool_1, job_file.rig.tool_2):
        if tool.error_map is not None:
            with contextlib.suppress(OSError):  # whoever reads the map says why
                rig.update(Path(tool.error_map).read_bytes())
    return {"rig": rig.hexdigest()[:12], "material": material.hexdigest()[:12]}


def _check_files(saved: dict[str, str], job_file: JobFile, path: Path) -> None:
    """Raise IsfError FILE_SYNTAX where rig or material of ``job_file`` are not those that were ``saved`` with."""
    named = {"rig": job_file.job.rig, "material": job_file.job.sheet.material}
    if changed := [name for name, digest in file_digests(job_file).items() if saved[name] != digest]:
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"was saved with another content of {' and '.join(f'{name} {named[name]}' for name in changed)}: the part "
            "would go on as a mixture of both",
            where=str(path),
            advice="bring back what the files held when it was saved, or form the part again and save it anew",
        )


@cache
def plant_digest(folder: Path = _SOURCES) -> str:
    """Digest of what this package computes, comments and docstrings left out: another one goes on otherwise."""
    text = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        tree = ast.parse(path.read_bytes())
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                node.body = [line for line in body if not _is_text(line)]  # type: ignore[attr-defined]
        text.update(path.relative_to(folder).as_posix().encode() + b"\0" + ast.dump(tree).encode())
    for path in sorted(folder.rglob("*.c")):
        text.update(path.read_bytes())
    return text.hexdigest()[:12]


def _is_text(line: ast.AST) -> bool:
    """A docstring, or a text under a variable."""
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)


def _encoder() -> Encoder:
    # a fresh machine has neither events nor, before its first coarse solution, points of a support
    return Encoder(records=(Event, SupportPoints), enums=(ErrorCode, EventKind))


def _read(path: Path) -> tuple[dict[str, Any], list[Any]]:
    advice = "save one with machine/save"
    try:
        archive = read_archive(path)
        header = parse_json(archive["header"].tobytes())
        arrays = [archive[f"a{k}"] for k in range(len(archive) - 1)]
    except FileNotFoundError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice=advice) from error
    except (OSError, KeyError, ValueError) as error:
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"is not a saved machine, or is damaged: {reason(error)}",
            where=str(path),
            advice=advice,
        ) from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise IsfError(ErrorCode.FILE_SYNTAX, "is no saved machine", where=str(path), advice=advice)
    if header.get("version") != VERSION:
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"is of format version {header.get('version')}, this software reads {VERSION}",
            where=str(path),
            advice=f"use version {header.get('software', '?')} of the software",
        )
    if header.get("plant") != plant_digest():
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"was saved by another plant: its sources have the digest {header.get('plant')}, these {plant_digest()}",
            where=str(path),
            advice=f"load it with the sources that saved it (version {header.get('software', '?')}), or form the "
            "part again from its job and save it anew",
        )
    return header, arrays
