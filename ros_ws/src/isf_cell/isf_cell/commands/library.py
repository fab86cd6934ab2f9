"""``isf library``: tools, blanks, plates, materials and rigs that a job may name, and the origin of their constants."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.files.tooling import LIBRARIES, Library, load_named
from rich.markup import escape

from isf_cell.commands import terminal


def _loader(library: Library) -> Callable[[str, Path | None], Any]:
    return lambda name, base: load_named(library, name, base)


KINDS: dict[str, Callable[[str, Path | None], Any]] = {
    **{library.folder: _loader(library) for library in LIBRARIES},
    "materials": load_material,
    "rigs": load_rig,
}
"""Folder of each kind, and what reads and checks one of its files."""


def show_library(kind: str | None, name: str | None, *, as_json: bool) -> None:
    """List all files, those of ``kind``, or the constants of the file ``name`` with their origin.

    Raises
    ------
    IsfError : FILE_NOT_FOUND for an unknown kind or name; what is wrong with a file of one's own, with its line
    """
    if kind is not None and kind not in KINDS:
        advice = f"known: {', '.join(KINDS)}"
        raise IsfError(ErrorCode.FILE_NOT_FOUND, f"no library of '{kind}'", where="KIND", advice=advice)
    if kind is None or name is None:
        found = {one: _listed(one) for one in ([kind] if kind else KINDS)}
        if as_json:
            terminal.print_json(found)
        for one, files in found.items():
            terminal.console.print(f"[bold]{one}[/bold]")
            for file, values in files.items():
                said = ", ".join(f"{key}={value}" for key, value in values.items())
                terminal.console.print(f"  [bold]{file}[/bold]  {escape(said)}", soft_wrap=True)
        return
    KINDS[kind](name, Path.cwd())
    written = _written(yaml_file.find_named(kind, name, Path.cwd()))
    rows = [
        {"constant": key, "value": _value(written, key), "origin": str(text)}
        for key, text in written.get("provenance", {}).items()
    ]
    if as_json:
        terminal.print_json({"kind": kind, "name": written.get("name", name), "constants": rows})
    table = terminal.table_of(f"{kind}: {written.get('name', name)}", "constant", "value", "origin")
    table.columns[-1].justify = "left"  # sentences
    for row in rows:
        table.add_row(*(escape(text) for text in row.values()))
    terminal.console.print(table)


def _listed(kind: str) -> dict[str, dict[str, str]]:
    """Names of the files that are installed, to what is written in one line of each."""
    paths = sorted((yaml_file.share_directory() / kind).glob("*.yaml"))
    return {
        path.stem: {
            key: _text(value)
            for key, value in _written(path).items()
            if key not in ("name", "provenance") and not isinstance(value, dict)
        }
        for path in paths
    }


def _written(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = yaml_file.content(yaml_file.read(path), str(path))
    return content


def _value(written: Any, key: str) -> str:
    """What is written at ``key`` ("limits.force"); empty for a group of constants, or one of the file below."""
    for part in key.split("."):
        written = written.get(part) if isinstance(written, dict) else None
    return "" if written is None or isinstance(written, dict) else _text(written)


def _text(value: Any) -> str:
    """A list as it stands in a file."""
    return f"[{', '.join(_text(item) for item in value)}]" if isinstance(value, list) else str(value)
