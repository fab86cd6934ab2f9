"""What golden runs ask of the product, and the numbers kept of its answers. Only this file imports the product.

A run is asked for in public terms: job files, the part formed in process, and the ``isf`` command. It returns *series*:
one array per contour (or a single one) with its quantity, by a name such as ``result.forming_force``. Texts for people,
names, dates and times of the wall clock are left out: they may change while results may not.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from golden_values import Array, Quantity, Series
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.options import RunOptions
from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_planner import plan

COMMAND = [sys.executable, "-m", "isf_cell.cli"]

CONTOUR = {
    "contact": Quantity.LENGTH,
    "normal": Quantity.RATIO,
    "wall_angle": Quantity.ANGLE,
    "thickness": Quantity.LENGTH,
    "forming_tip": Quantity.LENGTH,
    "support_tip": Quantity.LENGTH,
    "support_force": Quantity.FORCE,
    "speed": Quantity.LENGTH,
    "predicted_force": Quantity.FORCE,
}
CORRECTION = {
    "offset": Quantity.LENGTH,
    "springback": Quantity.LENGTH,
    "control_point": Quantity.LENGTH,
    "control_point_springback": Quantity.LENGTH,
    "control_point_force": Quantity.FORCE,
    "saturated": Quantity.COUNT,
    "uncertainty": Quantity.LENGTH,
    "residual": Quantity.LENGTH,
    "code": Quantity.COUNT,
}
RESULT = {
    "completed": Quantity.COUNT,
    "code": Quantity.COUNT,
    "start": Quantity.TIME,
    "end": Quantity.TIME,
    "forming_force": Quantity.FORCE,
    "support_force": Quantity.FORCE,
    "forming_target": Quantity.LENGTH,
    "support_target": Quantity.LENGTH,
    "forming_measured": Quantity.LENGTH,
    "support_measured": Quantity.LENGTH,
    "force_offset": Quantity.LENGTH,
    "compliance_offset": Quantity.LENGTH,
    "contact_fraction": Quantity.RATIO,
    "saturations": Quantity.COUNT,
    "backoffs": Quantity.COUNT,
    "tick_set_point": Quantity.FORCE,
    "tick_normal_force": Quantity.FORCE,
    "tick_engaged": Quantity.COUNT,
}

LEARNED = {
    "contour": Quantity.COUNT,
    "place": Quantity.LENGTH,
    "push": Quantity.LENGTH,
    "applied": Quantity.LENGTH,
    "error": Quantity.LENGTH,
    "gain": Quantity.RATIO,
    "feature": Quantity.RATIO,
    "springback": Quantity.LENGTH,
    "history": Quantity.LENGTH,
}
IDENTIFIED = {
    "compliance": Quantity.COMPLIANCE,
    "stiffness": Quantity.STIFFNESS,
    "servo": Quantity.FREQUENCY,
    "signs": Quantity.RATIO,
}


def planned(job: Path) -> dict[str, Series]:
    """Contours and target of the job file ``job``."""
    part = plan(JobFile(job.read_text(encoding="utf-8"), job.parent))
    series = {f"contour.{name}": _each(part.contours, name, kind, points=0) for name, kind in CONTOUR.items()}
    if any(contour.tilted for contour in part.contours):
        series["contour.forming_axis"] = _each(part.contours, "forming_axis", Quantity.RATIO, points=0)
    roles = ("index", "feature", "stage", "process", "forming_tool", "closed", "retract")
    of_tool = np.array([[int(getattr(contour, name)) for name in roles] for contour in part.contours])
    series["contour.roles"] = Series(Quantity.COUNT, [of_tool])
    series["contour.feed"] = Series(Quantity.LENGTH, [np.array([contour.feed for contour in part.contours])])
    holder = np.array([contour.holder_height for contour in part.contours])
    series["contour.holder_height"] = Series(Quantity.LENGTH, [holder])
    return {**series, **_surface("target", part.target)}


def formed(job: Path, springback: str, contours: int | None = None, **options: Any) -> dict[str, Series]:
    """The part of ``job`` with the YAML fields ``springback`` of that section, formed in process.

    ``contours`` : formed are so many (None: all); ``options`` : fields of the run options (variant, seed, ...)
    """
    number = count(1)
    record = in_process.form(
        JobFile(job_text(job, springback), job.parent),
        RunOptions(**options),
        cancelled=(lambda: next(number) >= contours) if contours else None,
    )
    return _of_record(record)


def formed_in_graph(job: Path, springback: str, folder: Path, **options: Any) -> dict[str, Series]:
    """The same part through the node graph in lockstep, read back from its bag in ``folder``."""
    written = folder / job.name
    text = job_text(job, springback)
    for up in ("../../../", "../"):  # meshes and rigs, seen from another folder
        text = text.replace(f": {up}", f": {(job.parent / up).resolve()}/")
    written.write_text(text, encoding="utf-8")
    given = [text for name, value in options.items() for text in (f"--{name.replace('_', '-')}", str(value))]
    _isf("form", written, "--no-compare", "-o", folder / "run", *given)
    return _of_record(read_bag(folder / "run" / "bag"))


def identified(job: Path, name: str, folder: Path, *more: object) -> dict[str, Series]:
    """Property ``name`` of the machine of ``job``, by ``isf identify``."""
    found = json.loads(_isf("identify", job, "-p", name, "-o", folder / "rig.yaml", *more))
    return {
        key: Series(IDENTIFIED[name], [np.array(found[key], dtype=float)], points=6) for key in ("value", "uncertainty")
    }


def database(job: Path, folder: Path) -> tuple[Path, dict[str, Series]]:
    """The load-displacement database of ``job`` as a file in ``folder``, by ``isf springback database``."""
    path = folder / "database.json"
    _isf("springback", "database", job, "-o", path, "--workers", 0)
    numbers = np.array(list(_numbers(json.loads(path.read_text(encoding="utf-8")))))
    return path, {"database": Series(Quantity.RELATIVE, [numbers], points=40)}


def learned(job: Path, folder: Path, **options: Any) -> dict[str, Series]:
    """What ``isf learn`` makes of the part of ``job`` formed by ``isf simulate``."""
    given = [text for name, value in options.items() for text in (f"--{name}", str(value))]
    _isf("simulate", job, "--no-compare", "-o", folder / "run", *given)
    _isf("learn", folder / "run", "-o", folder / "known.npz")
    with np.load(folder / "known.npz") as data:
        return {f"learned.{name}": Series(quantity, [data[name]]) for name, quantity in LEARNED.items()}


def job_text(job: Path, springback: str) -> str:
    """Text of ``job`` with the fields ``springback`` as that section."""
    return f"{job.read_text(encoding='utf-8')}springback: {{{springback}}}\n"


def method_names(job: Path) -> set[str]:
    """Names of all springback methods, as the product tells them to who asks for another; auto is one of the others."""
    try:
        in_process.form(JobFile(job.read_text(encoding="utf-8"), job.parent), RunOptions(correction="?"))
    except IsfError as refused:
        return {name.strip() for name in refused.advice.removeprefix("known:").split(",")} - {"auto"}
    raise AssertionError("a method of no name was accepted")


@contextmanager
def nothing_cached(folder: Path) -> Iterator[None]:
    """Results computed before and kept in the user's cache take no part; new ones go to ``folder``."""
    before = os.environ.get("ISF_CACHE_DIR")
    os.environ["ISF_CACHE_DIR"] = str(folder / "cache")
    try:
        yield
    finally:
        if before is None:
            del os.environ["ISF_CACHE_DIR"]
        else:
            os.environ["ISF_CACHE_DIR"] = before


def _isf(*arguments: object) -> str:
    """Standard output of the ``isf`` command."""
    command = [*COMMAND, *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"isf {' '.join(command[3:])} ended with {done.returncode}:\n{done.stderr}")
    return done.stdout


def _of_record(record: PartRecord) -> dict[str, Series]:
    series = {f"nominal.{name}": _each(record.nominal, name, CONTOUR[name]) for name in ("forming_tip", "support_tip")}
    for name, quantity in CORRECTION.items():
        series[f"correction.{name}"] = _each(record.corrections, name, quantity)
    for name, quantity in RESULT.items():
        series[f"result.{name}"] = _each(record.results, name, quantity)
    series["correction.remarks"] = Series(Quantity.COUNT, [np.array([len(c.remarks) for c in record.corrections])])
    series["part.end"] = Series(Quantity.TIME, [np.array([record.sim_time])])
    series["part.ticks"] = Series(Quantity.COUNT, [np.array([record.ticks])])
    series |= _surface("target", record.target) | _surface("scan", record.scan)
    if record.scans:
        series["scans.points"] = Series(Quantity.SCAN, [scan.points() for scan in record.scans], points=0)
    if record.events:
        series["events.kind"] = Series(Quantity.COUNT, [np.array([int(event.kind) for event in record.events])])
        series["events.time"] = Series(Quantity.TIME, [np.array([event.time for event in record.events])])
        series["events.position"] = Series(Quantity.LENGTH, [np.array([event.position for event in record.events])])
    return series


def _each(items: Sequence[object], name: str, quantity: Quantity, *, points: int = 2) -> Series:
    blocks = [np.asarray(getattr(item, name)) for item in items]
    if blocks and all(block.ndim == 0 for block in blocks):
        return Series(quantity, [np.array(blocks, dtype=float)], points=len(blocks))
    return Series(quantity, [np.flatnonzero(block) if block.dtype == bool else block for block in blocks], points)


def _surface(name: str, surface: Any) -> dict[str, Series]:
    """Height map: all of it, and the section through its middle."""
    if surface is None:
        return {}
    middle: Array = surface.z[len(surface.y) // 2]
    return {
        f"{name}.z": Series(Quantity.LENGTH, [surface.z.ravel()], points=0),
        f"{name}.middle_section": Series(Quantity.LENGTH, [middle], points=20),
    }


def _numbers(value: Any) -> Iterator[float]:
    """All numbers of a JSON value in order."""
    if isinstance(value, dict):
        for key in sorted(value):
            yield from _numbers(value[key])
    elif isinstance(value, list):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)
