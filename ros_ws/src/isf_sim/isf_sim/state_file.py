"""A simulated machine saved to one file and taken up again: sheet, axes, load cells, events, generators, time.

The file is a numpy archive of plain arrays with a header in JSON: format, version, digest of the sources of the plant,
job, world, seed and the structure of the state. A machine taken up goes on bit by bit as the saved one would have gone
on, with the same software; a file saved by another plant is refused.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import zipfile
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError
from isf_core.job import JobFile

from isf_sim.machine import SimulatedMachine
from isf_sim.machine_event import EventKind, MachineEvent
from isf_sim.plant_constants import PlantConstants
from isf_sim.shell_assembly import SupportPoints
from isf_sim.state_tree import Encoder, StateMismatchError, differing

FORMAT, VERSION = "isf-machine-state", 2


def save_machine(machine: SimulatedMachine, path: str | Path) -> Path:
    """Write ``machine`` to ``path`` as it is; returns the path.

    Raises
    ------
    IsfError : FILE_NOT_WRITABLE
    """
    path = Path(path)
    encoder = _encoder()
    state = {name: encoder.encode(value) for name, value in machine.changing().items()}
    header = {
        "format": FORMAT,
        "version": VERSION,
        "software": __version__,
        "plant": plant_digest(),
        "job": machine.job_file.text,
        "base": str(machine.job_file.base),
        "world": machine.world_number,
        "seed": machine.seed,
        "constants": dataclasses.asdict(machine.plant_constants),
        "state": state,
    }
    arrays: dict[str, Any] = {f"a{k}": array for k, array in enumerate(encoder.arrays)}
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            np.savez_compressed(file, header=np.frombuffer(json.dumps(header).encode(), dtype=np.uint8), **arrays)
        partial.replace(path)  # a file that is there is a whole one
    except OSError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_WRITABLE, f"cannot be written: {error}", where=str(path), advice="choose another folder"
        ) from error
    return path


def load_machine(path: str | Path) -> SimulatedMachine:
    """The machine of a file as :func:`save_machine` writes it.

    Raises
    ------
    IsfError : FILE_NOT_FOUND; FILE_SYNTAX (not such a file, damaged, other version or plant); as JobFile for
        the job in it
    """
    path = Path(path)
    header, arrays = _read(path)
    job_file = JobFile(header["job"], Path(header["base"]), f"job in {path.name}")
    try:
        machine = SimulatedMachine(
            job_file,
            world=header["world"],
            seed=header["seed"],
            constants=PlantConstants(**header["constants"]),
        )
        fresh, encoder = machine.changing(), _encoder()
        if set(header["state"]) != set(fresh):
            raise StateMismatchError(f"a machine has other fields than the file ({differing(header['state'], fresh)})")
        machine.__dict__.update(
            {name: encoder.decode(code, arrays, fresh[name]) for name, code in header["state"].items()}
        )
    except (StateMismatchError, KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise IsfError(
            ErrorCode.FILE_SYNTAX,
            f"does not fit this software: {error}",
            where=str(path),
            advice=f"it was saved by version {header.get('software', '?')}, this is {__version__}",
        ) from error
    return machine


@cache
def plant_digest() -> str:
    """Digest of the sources of this package: with others the same state goes on otherwise."""
    folder = Path(__file__).resolve().parent
    text = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        text.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return text.hexdigest()[:12]


def _encoder() -> Encoder:
    # a fresh machine has neither events nor, before its first coarse solution, points of a support
    return Encoder(records=(MachineEvent, SupportPoints), enums=(ErrorCode, EventKind))


def _read(path: Path) -> tuple[dict[str, Any], list[Any]]:
    advice = "save one with machine/save"
    try:
        with np.load(path, allow_pickle=False) as archive:
            header = json.loads(archive["header"].tobytes())
            arrays = [archive[f"a{k}"] for k in range(len(archive.files) - 1)]
    except FileNotFoundError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice=advice) from error
    except (OSError, EOFError, KeyError, ValueError, AttributeError, zipfile.BadZipFile, zlib.error) as error:
        raise IsfError(
            ErrorCode.FILE_SYNTAX, f"is no saved machine, or damaged: {error}", where=str(path), advice=advice
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
            advice=f"take it up with the sources it was saved by (version {header.get('software', '?')}), or form the "
            "part again from its job and save it anew",
        )
    return header, arrays
