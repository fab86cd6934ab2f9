"""A whole plan in one file: JSON head and arrays in a NumPy archive (.npz), nothing executable, any platform.

All points of all contours stand behind each other in one array per field; the head tells how many belong to each
contour. A field that a later version adds to the contour is written and read like the others. What an older version
must not leave out without a word has a version of its own: 2, the axis of a tilted tool; 3, the speed of a spindle.
Plans with neither are written as version 1.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from isf_core.contour import Contour, Process, with_floor_passes
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.archive import read_archive
from isf_core.files.bounded import parse_json
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array, Points

from isf_planner.part_plan import Plan

VERSIONS = (1, 2, 3)

_TYPES = get_type_hints(Contour, include_extras=True)
_ARRAYS = tuple(name for name, kind in _TYPES.items() if kind in (Array, Points))
_VALUES = tuple(name for name in _TYPES if name not in _ARRAYS)


def save_plan(plan: Plan, path: Path) -> Path:
    """Write ``plan`` to ``path`` (.npz) and return it; the loop tree is left out. IsfError FILE_NOT_WRITABLE."""
    head = {
        "format": "isf plan",
        "version": 3 if plan.spindle else 2 if any(contour.tilted for contour in plan.contours) else 1,
        "plan_id": plan.plan_id,
        "warnings": list(plan.warnings),
        "ball_radius": plan.ball_radius,
        "origin": list(plan.origin),
        "spindle": list(plan.spindle),
        "contours": [
            {name: _plain(getattr(contour, name)) for name in _VALUES}
            | {"lengths": {name: len(getattr(contour, name)) for name in _ARRAYS}}
            for contour in plan.contours
        ],
    }
    contents: dict[str, Any] = {
        f"contour_{name}": np.concatenate([getattr(contour, name).ravel() for contour in plan.contours])
        for name in _ARRAYS
    }
    contents |= {f"target_{axis}": getattr(plan.target, axis) for axis in "xyz"}
    if plan.preforms:
        contents["preforms"] = np.stack([preform.z for preform in plan.preforms])
    contents |= {"head": np.array(json.dumps(head)), "mesh_vertices": plan.mesh[0], "mesh_faces": plan.mesh[1]}
    try:
        with path.open("wb") as file:
            np.savez_compressed(file, **contents)
    except OSError as error:
        what = f"the plan cannot be written: {error.strerror}"
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, what, where=str(path)) from error
    return path


def load_plan(path: Path) -> Plan:
    """Plan of a file of :func:`save_plan`, without a loop tree; IsfError FILE_NOT_FOUND or PLAN_FILE_UNREADABLE."""
    try:
        data = read_archive(path)
        head = parse_json(str(data["head"]))
        _check_head(head, path)
        stored = {name: data[f"contour_{name}"] for name in _ARRAYS if f"contour_{name}" in data}
        contours = _contours(head["contours"], stored)
        target = HeightMap(*(data[f"target_{axis}"] for axis in "xyz"))
        mesh = (data["mesh_vertices"], data["mesh_faces"])
        _check_shapes(target, *mesh)
        preforms = tuple(HeightMap(target.x, target.y, z) for z in data.get("preforms", ()))
        for preform in preforms:
            _check_shapes(preform, *mesh)
        ball = float(head.get("ball_radius", "nan"))
        warnings = tuple(map(str, head["warnings"]))
        origin = tuple(map(str, head.get("origin", ())))
        plan_id = str(head["plan_id"])
        plan = Plan(plan_id, contours, target, mesh, warnings, ball_radius=ball, preforms=preforms, origin=origin)
        return replace(plan, spindle=_spindle(head.get("spindle", []), len(contours)))
    except FileNotFoundError as error:
        raise IsfError(ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path)) from error
    except OSError as error:
        raise _unreadable(path, f"cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, IsfError) as error:  # fields of other kinds
        if isinstance(error, IsfError) and error.code is ErrorCode.PLAN_FILE_UNREADABLE:
            raise
        raise _unreadable(path, "is not a complete plan file") from error


def _check_head(head: Any, path: Path) -> None:
    if not isinstance(head, dict) or head.get("format") != "isf plan":
        raise _unreadable(path, "is not a plan file")
    if head.get("version") not in VERSIONS:
        known = ", ".join(map(str, VERSIONS))
        raise _unreadable(path, f"is a plan file of version {head.get('version')}, this software reads {known}")


def _spindle(speeds: Any, count: int) -> tuple[float, ...]:
    """rad/s of every contour, or none; ValueError for other numbers of them, and for what is no speed."""
    if not isinstance(speeds, list) or len(speeds) not in (0, count):
        raise ValueError("the speeds of the spindle are not those of the contours")
    found = tuple(float(speed) for speed in speeds)
    if not np.isfinite(found).all():
        raise ValueError("a speed of the spindle is no number")
    return found


def _check_shapes(target: HeightMap, vertices: Array, faces: Array) -> None:
    """Raise ValueError for a target that is no height map, and facets that have no vertices; z may be NaN."""
    for axis in (target.x, target.y):
        if axis.dtype.kind != "f" or axis.ndim != 1 or len(axis) < 2 or not (np.diff(axis) > 0.0).all():
            raise ValueError("an axis of the target does not rise")
    if target.z.dtype.kind != "f" or target.z.shape != (len(target.y), len(target.x)) or np.isinf(target.z).any():
        raise ValueError("the heights of the target do not fit its axes")
    if vertices.dtype.kind != "f" or vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError("the vertices of the mesh are no points")
    if faces.dtype.kind not in "iu" or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError("the facets of the mesh are no triangles")
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError("a facet of the mesh refers to a vertex that is not there")


def _unreadable(path: Path, what: str) -> IsfError:
    return IsfError(
        ErrorCode.PLAN_FILE_UNREADABLE, what, where=str(path), advice="plan the part again with isf plan --export"
    )


def _contours(heads: list[dict[str, Any]], stored: dict[str, Array]) -> tuple[Contour, ...]:
    for name, array in stored.items():
        if array.dtype.kind not in "fiu" or array.ndim != 1:
            raise ValueError(f"{name} are no numbers in a row")
    at = dict.fromkeys(stored, 0)
    contours = []
    for head in heads:
        values: dict[str, Any] = {}
        for name, array in stored.items():
            width = 3 if _TYPES[name] == Points else 1
            size = head["lengths"][name] * width
            piece = array[at[name] : at[name] + size]
            if len(piece) != size:
                raise ValueError(f"{name} ends early")
            values[name] = piece.reshape(-1, 3) if width == 3 else piece
            at[name] += size
        values |= {name: head[name] for name in _VALUES if name in head}
        values["process"] = Process(values["process"])
        contours.append(Contour(**values).validate())
    return with_floor_passes(contours)


def _plain(value: Any) -> Any:
    return int(value) if isinstance(value, Process) else value
