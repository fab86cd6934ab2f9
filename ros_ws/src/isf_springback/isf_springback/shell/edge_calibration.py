"""The edge condition of a clamp from one push on the flat sheet: a measured curve goes in, the condition comes out.

The condition shifts every predicted springback by 20 to 40 %, and no drawing tells it (Ren 2018, 4.3.2, where one
push of 400 N at the centre chose among four). Here the in-plane spring of the clamped edge is fitted, and the four
plain conditions are told beside it.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_lines
from isf_core.types import Array
from scipy.optimize import minimize_scalar

from isf_springback.shell.load_path import follow_load
from isf_springback.shell.plan_mesh import mesh_in_plan, rectangle
from isf_springback.shell.sheet_model import EdgeCondition, SheetMesh, ShellModel

CONDITIONS = {
    "clamped, free in plane": EdgeCondition("clamped", 0.0),
    "clamped, immovable": EdgeCondition("clamped", np.inf),
    "supported, free in plane": EdgeCondition("supported", 0.0),
    "supported, immovable": EdgeCondition("supported", np.inf),
}

_UNITS = {"n": 1.0, "kn": 1e3, "m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}

_SOFTEST, _STIFFEST = 1e6, 1e12
"""Pa; beyond these the spring is the same as a free or an immovable edge."""


_LOADS = 7
"""Loads computed for one condition; a longer curve is read between them."""


@dataclass(frozen=True)
class PushCurve:
    """Measured push: ``force`` (K,) N rising, ``displacement`` (K,) m along the push, at ``place`` (2,) m."""

    force: Array
    displacement: Array
    place: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class EdgeCalibration:
    """What the push says.

    Attributes
    ----------
    edge : fitted condition; deviation : m, rms difference that remains with it
    plain : rms difference, m, of each plain condition
    force, measured, fitted : (K,) N, m, m, the curves
    """

    edge: EdgeCondition
    deviation: float
    plain: dict[str, float]
    force: Array
    measured: Array
    fitted: Array


def read_push_curve(path: Path, place: tuple[float, float] = (0.0, 0.0)) -> PushCurve:
    """Curve of a CSV file with the columns force_UNIT and displacement_UNIT (N, kN; m, mm, um) in its header.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, FILE_UNIT, PUSH_CURVE_UNUSABLE
    """
    try:
        lines = read_lines(path)
    except FileNotFoundError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND, "there is no such push curve", where=str(path), advice="check the path"
        ) from error
    except OSError as error:
        raise _unusable(f"it cannot be read: {error.strerror}", str(path)) from error
    rows = [row for row in csv.reader(lines) if row and row[0][:1] != "#"]
    header = [name.strip().lower() for name in rows[0]] if rows else []
    columns = []
    for quantity, units in (("force", ("n", "kn")), ("displacement", ("m", "mm", "um", "µm"))):
        found = [(k, m.group(1)) for k, name in enumerate(header) if (m := re.fullmatch(f"{quantity}_(\\w+)", name))]
        if len(found) != 1 or found[0][1] not in units:
            raise IsfError(
                ErrorCode.FILE_UNIT,
                f"no column {quantity}_UNIT in its header",
                where=str(path),
                advice="the first line is for example: force_N,displacement_mm",
            )
        columns.append((found[0][0], _UNITS[found[0][1]]))
    try:
        values = np.array([[float(row[k]) * unit for k, unit in columns] for row in rows[1:]], dtype=np.float64)
    except (ValueError, IndexError) as error:
        raise _unusable("a line is not two numbers", str(path)) from error
    return checked(PushCurve(values[:, 0], values[:, 1], place) if len(values) else _empty(place), str(path))


def checked(curve: PushCurve, where: str = "push curve") -> PushCurve:
    """``curve`` sorted by force, unloaded readings left out.

    Raises
    ------
    IsfError : PUSH_CURVE_UNUSABLE, fewer than three loads, not finite, or not rising
    """
    if not (np.isfinite(curve.force).all() and np.isfinite(curve.displacement).all()):
        raise _unusable("a number is not finite", where)
    order = np.argsort(curve.force, kind="stable")
    force, displacement = curve.force[order], curve.displacement[order]
    loaded = force > 0.01 * max(float(force.max()), 0.0) if len(force) else np.zeros(0, dtype=bool)
    force, displacement = force[loaded], displacement[loaded]
    if len(force) < 3 or (np.diff(force) <= 0).any():
        raise _unusable("needs three or more different loads above zero", where)
    if displacement[0] <= 0 or np.corrcoef(force, displacement)[0, 1] < 0.5:
        raise _unusable("the displacement does not rise with the force", where)
    return PushCurve(force, displacement, curve.place)


def calibrate_edge(
    curve: PushCurve, clamp_size: tuple[float, float], thickness: float, young: float, poisson: float
) -> EdgeCalibration:
    """Edge that fits ``curve`` best on a flat sheet of ``clamp_size`` m and ``thickness`` m; ``young`` Pa.

    Raises
    ------
    IsfError : PUSH_CURVE_UNUSABLE; SHEET_MESH_FAILED; SHELL_NOT_SOLVED
    """
    curve = checked(curve)
    mesh = _flat_mesh(clamp_size, curve.place)
    tension = np.full(len(mesh.triangles), thickness)
    loads = curve.force if len(curve.force) <= _LOADS else np.geomspace(curve.force[0], curve.force[-1], _LOADS)

    def pushed(edge: EdgeCondition) -> Array:
        model = ShellModel(mesh, tension, young, poisson, edge)
        moved = -follow_load(model, 0, np.array([0.0, 0.0, -1.0]), loads, model.factor())[:, 2]
        return np.exp(np.interp(np.log(curve.force), np.log(loads), np.log(moved)))  # a power law between the loads

    def misfit(edge: EdgeCondition) -> float:
        return float(np.sqrt(np.mean((pushed(edge) - curve.displacement) ** 2)))

    plain = {name: misfit(edge) for name, edge in CONDITIONS.items()}
    found = minimize_scalar(
        lambda exponent: misfit(EdgeCondition("clamped", 10.0**exponent)),
        bounds=(np.log10(_SOFTEST), np.log10(_STIFFEST)),
        method="bounded",
        options={"xatol": 0.03, "maxiter": 16},
    )
    candidates = {name: (value, CONDITIONS[name]) for name, value in plain.items()}
    candidates["fitted"] = (float(found.fun), EdgeCondition("clamped", float(10.0**found.x)))
    # a plain condition that explains the curve as well is the simpler answer
    best = min(candidates, key=lambda name: candidates[name][0] * (1.02 if name == "fitted" else 1.0))
    edge = candidates[best][1]
    return EdgeCalibration(edge, candidates[best][0], plain, curve.force, curve.displacement, pushed(edge))


def _flat_mesh(clamp_size: tuple[float, float], place: tuple[float, float]) -> SheetMesh:
    load = np.asarray(place, dtype=np.float64)[None]
    largest = min(clamp_size) / 18.0

    def size(points: Array) -> Array:
        return np.minimum(0.2 * largest + 0.25 * np.linalg.norm(points - load, axis=1), largest)

    points, triangles, edge = mesh_in_plan(rectangle(clamp_size), load, size)
    return SheetMesh(np.column_stack([points, np.zeros(len(points))]), triangles, edge, np.array([0]))


def _empty(place: tuple[float, float]) -> PushCurve:
    return PushCurve(np.empty(0), np.empty(0), place)


def _unusable(what: str, where: str) -> IsfError:
    return IsfError(
        ErrorCode.PUSH_CURVE_UNUSABLE,
        f"the push curve cannot be used: {what}",
        where=where,
        advice="push the flat sheet slowly, without yielding, and write rising forces with their displacements",
    )
