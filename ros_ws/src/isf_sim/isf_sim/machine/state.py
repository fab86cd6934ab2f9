"""A simulated machine saved to one file and taken up again: sheet, axes, load cells, events, generators, time.

The file is a numpy archive of plain arrays with a header in JSON: format, version, digest of the sources of the plant,
job, variant, seed, blank and the structure of the state. A machine taken up goes on bit by bit as the saved one would
have gone on, with the same software; a file saved by another plant is refused.
"""

from __future__ import annotations

import ast
import dataclasses
import enum
import hashlib
import json
import types
import zipfile
import zlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pydantic
from isf_core import __version__
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import Event, EventKind
from isf_core.files.job import JobFile
from numpy.typing import NDArray
from scipy import sparse

from isf_sim.machine.simulated_machine import MachineState, SimulatedMachine
from isf_sim.plant_constants import PlantConstants
from isf_sim.shell.shell_assembly import SupportPoints

_SOURCES = Path(__file__).resolve().parents[1]

FORMAT, VERSION = "isf-machine-state", 7


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
        "variant": machine.variant_number,
        "seed": machine.seed,
        "blank": machine.blank,
        "sheet": machine.sheet_kind,
        "constants": dataclasses.asdict(machine.plant_constants),
        "state": state,
    }
    arrays: dict[str, Any] = {f"a{k}": array for k, array in enumerate(encoder.arrays)}
    partial = path.with_name(path.name + ".partial")
    try:
        partial.unlink(missing_ok=True)  # a link of that name is not followed
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
            variant=header["variant"],
            seed=header["seed"],
            blank=header["blank"],
            constants=PlantConstants(**header["constants"]),
            sheet=header["sheet"],
        )
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
        with np.load(path, allow_pickle=False) as archive:
            header = json.loads(archive["header"].tobytes())
            arrays = [archive[f"a{k}"] for k in range(len(archive.files) - 1)]
    except FileNotFoundError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice=advice) from error
    except (OSError, EOFError, KeyError, ValueError, AttributeError, zipfile.BadZipFile, zlib.error) as error:
        raise IsfError(
            ErrorCode.FILE_SYNTAX, f"is not a saved machine, or is damaged: {error}", where=str(path), advice=advice
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


_OWN = "isf_"
"""Objects of classes of our own packages are followed."""


class StateMismatchError(ValueError):
    """A value does not fit the object it is meant for."""


class Encoder:
    """Collects arrays while it turns values into JSON-able ones."""

    def __init__(self, records: tuple[type, ...] = (), enums: tuple[type[enum.Enum], ...] = ()) -> None:
        self.arrays: list[NDArray[Any]] = []
        self._seen: dict[int, int] = {}
        self._records = {kind.__name__: kind for kind in records}
        self._enums = {kind.__name__: kind for kind in enums}

    def encode(self, value: Any) -> Any:
        """JSON-able form of ``value``; TypeError for what is neither state nor known to be constant."""
        if value is None or isinstance(value, bool | str):
            return {"v": value}
        if isinstance(value, enum.Enum):
            if type(value).__name__ not in self._enums:
                raise TypeError(f"cannot save {type(value)}")
            return {"e": [type(value).__name__, value.value]}
        if isinstance(value, int):
            return {"v": int(value)}
        if isinstance(value, float):
            return {"f": float(value).hex()}
        if isinstance(value, np.generic):
            return self.encode(value.item())
        if isinstance(value, np.ndarray):
            return {"a": self._keep(value)}
        if isinstance(value, np.random.Generator):
            return {"g": value.bit_generator.state}
        return self._encode_compound(value)

    def _encode_compound(self, value: Any) -> Any:
        if type(value).__name__ in self._records:
            names = getattr(value, "_fields", None) or [item.name for item in dataclasses.fields(value)]
            return {"r": [type(value).__name__, {name: self.encode(getattr(value, name)) for name in names}]}
        if isinstance(value, tuple | list):
            kind = "n" if hasattr(value, "_fields") else "t" if isinstance(value, tuple) else "l"
            return {kind: [self.encode(item) for item in value]}
        if isinstance(value, dict):
            return {"d": [[self.encode(key), self.encode(item)] for key, item in value.items()]}
        if sparse.issparse(value):
            return {"a": self._keep(value.data)} if hasattr(value, "indptr") else {"k": 0}
        if _is_constant(value):
            return {"k": 0}
        if type(value).__module__.startswith(_OWN):
            return {"o": {name: self.encode(item) for name, item in vars(value).items()}}
        raise TypeError(f"cannot save a {type(value).__module__}.{type(value).__name__}")

    def _keep(self, array: NDArray[Any]) -> int:
        if array.dtype.hasobject:
            raise TypeError("cannot save an array of objects")
        if id(array) not in self._seen:
            self._seen[id(array)] = len(self.arrays)
            self.arrays.append(array)
        return self._seen[id(array)]

    def decode(self, code: Any, arrays: list[NDArray[Any]], into: Any) -> Any:
        """Value of ``code``; ``into`` is the fresh value in its place, written in place where that can be done.

        Raises
        ------
        StateMismatchError : the code is of another build
        """
        ((kind, body),) = code.items()
        if kind == "v":
            return body
        if kind == "f":
            return float.fromhex(body)
        if kind == "e":
            return self._enums[body[0]](body[1])
        if kind == "a":
            return _array(arrays[body], into)
        if kind == "g":
            into.bit_generator.state = body
            return into
        if kind == "k":
            return into
        if kind == "r":
            record = self._records[body[0]]
            return record(**{name: self.decode(item, arrays, None) for name, item in body[1].items()})
        if kind == "o":
            return self._decode_object(body, arrays, into)
        return self._decode_container(kind, body, arrays, into)

    def _decode_object(self, body: dict[str, Any], arrays: list[NDArray[Any]], into: Any) -> Any:
        if not type(into).__module__.startswith(_OWN) or set(body) != set(vars(into)):
            fields = vars(into) if type(into).__module__.startswith(_OWN) else {}
            raise StateMismatchError(
                f"{type(into).__name__} has other fields than the file ({differing(body, fields)})"
            )
        for name, item in body.items():
            vars(into)[name] = self.decode(item, arrays, vars(into)[name])
        return into

    def _decode_container(self, kind: str, body: list[Any], arrays: list[NDArray[Any]], into: Any) -> Any:
        if kind == "d":
            fresh = into if isinstance(into, dict) else {}
            pairs = [(self.decode(key, arrays, None), item) for key, item in body]
            return {key: self.decode(item, arrays, fresh.get(key)) for key, item in pairs}
        old = list(into) if isinstance(into, tuple | list) else []
        items = [self.decode(item, arrays, old[k] if k < len(old) else None) for k, item in enumerate(body)]
        if kind == "l":
            return items
        if kind == "t":
            return tuple(items)
        if not hasattr(into, "_fields") or len(old) != len(items):
            raise StateMismatchError(f"{type(into).__name__} has other fields than the file")
        return into if all(new is was for new, was in zip(items, old, strict=True)) else type(into)(*items)


def differing(saved: Iterable[str], present: Iterable[str]) -> str:
    """Names that are only in the one or the other, for a message."""
    old, new = set(saved), set(present)
    parts = (("only in the file", old - new), ("missing in it", new - old))
    return "; ".join(f"{words}: {', '.join(sorted(names))}" for words, names in parts if names)


def _is_constant(value: Any) -> bool:
    """What a fresh tree holds as well: models of files, frozen constants, functions, classes, caches that say so."""
    frozen = getattr(getattr(type(value), "__dataclass_params__", None), "frozen", False)
    return bool(
        frozen
        or getattr(type(value), "constant_of_state", False)
        or isinstance(value, pydantic.BaseModel | type | types.FunctionType | types.MethodType)
        or type(value).__name__ == "CPUDispatcher"
    )


def _array(array: NDArray[Any], into: Any) -> Any:
    if sparse.issparse(into):
        if into.data.shape != array.shape:
            raise StateMismatchError("a matrix of another size")
        into.data[...] = array
        return into
    if (
        isinstance(into, np.ndarray)
        and into.shape == array.shape
        and into.dtype == array.dtype
        and into.flags.writeable
    ):
        into[...] = array
        return into
    return array.copy()
