"""``isf part``: parts of the library as mesh files."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import quantity
from isf_planner.part_library import PARTS, part_mesh

from isf_cell.commands import terminal

COUNTS, FACTORS = ("points",), ("scale",)


def make_part(name: str | None, values: tuple[str, ...], output: Path | None, *, as_json: bool) -> None:
    """Write the part ``name`` with changed dimensions, or list all parts; raises IsfError."""
    if name is None:
        if as_json:
            terminal.print_json({known: _defaults(known) for known in PARTS})
        for known in PARTS:
            sizes = ", ".join(f"{key}={value}" for key, value in _defaults(known).items())
            terminal.console.print(f"[bold]{known}[/bold]  {sizes}", soft_wrap=True)
        return
    if name not in PARTS:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, f"no part '{name}'", advice=f"known: {', '.join(PARTS)}")
    arguments = dict(_argument(name, text) for text in values)
    try:
        part = PARTS[name](**arguments)
        mesh = part_mesh(part)
    except ValueError as error:
        raise IsfError(ErrorCode.FILE_FIELD, f"{name} cannot be made: {error}", where="--set") from error
    path = output or Path(f"{name}.stl")
    try:
        trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces, process=False).export(path)
    except (OSError, ValueError) as error:
        what = f"the mesh cannot be written: {error}"
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, what, where=str(path), advice="use .stl, .ply or .obj") from error
    if as_json:
        terminal.print_json({"mesh": str(path), "unit": "mm", "facets": len(mesh.faces), "depth_mm": 1e3 * part.depth})
    terminal.say(f"{path}: {len(mesh.faces)} facets, {1e3 * part.depth:.2f} mm deep; unit mm")


def _defaults(name: str) -> dict[str, str]:
    """Dimensions for people."""
    return {key: _text(key, item.default) for key, item in inspect.signature(PARTS[name]).parameters.items()}


def _text(key: str, value: Any) -> str:
    if key in (*COUNTS, *FACTORS):
        return f"{value:g}"
    return f"{np.degrees(value):g} deg" if _is_angle(key) else f"{1e3 * value:g} mm"


def _is_angle(key: str) -> bool:
    return "angle" in key or key in ("steepest", "flattest")


def _argument(name: str, text: str) -> tuple[str, Any]:
    key, equals, value = (item.strip() for item in text.partition("="))
    known = inspect.signature(PARTS[name]).parameters
    if not equals or key not in known:
        advice = f"dimensions of {name}: {', '.join(known)}"
        raise IsfError(ErrorCode.FILE_FIELD, f"'{text}' is not a dimension of {name}", where="--set", advice=advice)
    try:
        if key in COUNTS:
            return key, int(value)
        if key in FACTORS:
            return key, float(value)
        return key, quantity.parse(value, "rad" if _is_angle(key) else "m")
    except ValueError as error:
        example = f"{key}={_text(key, known[key].default)}"
        raise IsfError(
            ErrorCode.FILE_UNIT, str(error), where=f"--set {text}", advice=f"for example {example}"
        ) from error
