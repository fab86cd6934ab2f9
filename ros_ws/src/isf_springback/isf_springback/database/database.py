"""Load-displacement database of a part: computed before forming, looked up while forming.

One level per control loop. Results of single depths are cached by the content of their task in the user's cache
folder, so an interrupted computation goes on where it was, and a changed part computes anew only what changed.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_json, reason
from isf_core.files.job import JobFile
from isf_core.files.whole_file import replacing
from isf_core.types import Array
from numpy.typing import NDArray

from isf_springback.database.control_points import ControlLoop
from isf_springback.database.elastic_samples import ENGINE_VERSION
from isf_springback.database.load_displacement import CubicLaw, PowerLaw, cubic_law, power_law

FORMAT = "isf-springback-database-1"


@dataclass(frozen=True)
class DatabaseLevel:
    """Control points of one contour, M of them, and what was computed there.

    Attributes
    ----------
    index, feature, stage : the contour, its feature and its stage
    depth : m, mean height of the loop
    points : (M, 3) m, contact points in path order
    central : (M,) bool, middle of a stretch of like features; else a boundary
    displacement : (M, L) m along the push at the loads of the database
    """

    index: int
    feature: int
    depth: float
    points: Array
    central: NDArray[np.bool_]
    displacement: Array
    stage: int = 0

    def cubic(self, loads: Array) -> CubicLaw:
        """Law used for corrections."""
        return cubic_law(loads, self.displacement)

    def power(self, loads: Array) -> PowerLaw:
        """Published law."""
        return power_law(loads, self.displacement)


@dataclass(frozen=True)
class Database:
    """All control loops of a plan: ``loads`` (L,) N, ``levels`` in the order of the contours, ``job`` its name."""

    job: str
    loads: Array
    levels: tuple[DatabaseLevel, ...]
    computed: int

    def save(self, path: Path) -> None:
        """Write as JSON, with both laws for readers of the file.

        Raises
        ------
        IsfError : FILE_NOT_WRITABLE
        """
        levels = []
        for level in self.levels:
            power, cubic = level.power(self.loads), level.cubic(self.loads)
            published = {"a_m_per_N^b": power.a.tolist(), "b": power.b.tolist(), "r2": power.r_squared.tolist()}
            levels.append(
                {
                    "contour": level.index,
                    "feature": level.feature,
                    **({"stage": level.stage} if level.stage else {}),
                    "depth_m": level.depth,
                    "points_m": np.round(level.points, 7).tolist(),
                    "central": level.central.tolist(),
                    "displacement_m": np.round(level.displacement, 9).tolist(),
                    "power_law": published,
                    "cubic_law_N_per_m^i": cubic.k.tolist(),
                }
            )
        data = {
            "format": FORMAT,
            "engine": ENGINE_VERSION,
            "job": self.job,
            "computed_points": self.computed,
            "loads_N": self.loads.tolist(),
            "levels": levels,
        }
        write_json(path, data)

    @staticmethod
    def load(path: Path) -> Database:
        """Read a file made by :meth:`save`.

        Raises
        ------
        IsfError : FILE_NOT_FOUND, DATABASE_UNUSABLE
        """
        if not path.exists():
            raise IsfError(
                ErrorCode.FILE_NOT_FOUND,
                "there is no such springback database",
                where=str(path),
                advice="make it with: isf springback database JOB",
            )
        try:
            data = read_json(path)
            if data["format"] != FORMAT or data["engine"] != ENGINE_VERSION:
                raise ValueError("made by another version")
            loads = np.array(data["loads_N"], dtype=np.float64)
            levels = tuple(_level(item, len(loads)) for item in data["levels"])
            if not levels:
                raise ValueError("it holds no levels")
            database = Database(str(data["job"]), loads, levels, int(data["computed_points"]))
            for level in levels:
                level.cubic(loads)
        except (ValueError, KeyError, TypeError, OverflowError, OSError, IsfError) as error:
            raise IsfError(
                ErrorCode.DATABASE_UNUSABLE,
                f"the springback database cannot be used: {reason(error)}",
                where=str(path),
                advice="make it again with: isf springback database JOB",
            ) from error
        return database


def _level(item: dict[str, Any], loads: int) -> DatabaseLevel:
    points = np.array(item["points_m"], dtype=np.float64)
    displacement = np.array(item["displacement_m"], dtype=np.float64)
    central = np.array(item["central"], dtype=bool)
    fits = points.ndim == 2 and points.shape[1] == 3 and len(points) > 0
    if not fits or displacement.shape != (len(points), loads) or central.shape != (len(points),):
        raise ValueError(f"contour {item['contour']}: points and samples do not belong together")
    if not (np.isfinite(points).all() and np.isfinite(displacement).all()):
        raise ValueError(f"contour {item['contour']}: a number is missing or not finite")
    stage = int(item.get("stage", 0))  # written where it is a further one
    return DatabaseLevel(
        int(item["contour"]), int(item["feature"]), float(item["depth_m"]), points, central, displacement, stage
    )


def make_database(
    job_name: str,
    loads: Array,
    contours: Sequence[Contour],
    loops: Sequence[ControlLoop],
    samples: Sequence[Array],
) -> Database:
    """Database of ``loops``; ``samples`` (computed, L) m of each loop's computed points, spread to their images."""
    by_index = {contour.index: contour for contour in contours}
    levels = []
    for loop, rows in zip(loops, samples, strict=True):
        row_of = {int(point): row for point, row in zip(loop.computed, rows, strict=True)}
        displacement = np.stack([row_of[int(point)] for point in loop.same_as])
        contour = by_index[loop.index]
        depth = float(loop.points[:, 2].mean())
        levels.append(
            DatabaseLevel(
                loop.index, contour.feature, depth, loop.points, loop.central, displacement, stage=contour.stage
            )
        )
    return Database(job_name, loads, tuple(levels), sum(len(rows) for rows in samples))


def cache_folder() -> Path:
    """Folder of computed results: $ISF_CACHE_DIR, else the user's cache folder."""
    chosen = os.environ.get("ISF_CACHE_DIR")
    if chosen:
        return Path(chosen) / "springback"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isf" / "springback"


PLATE_EDGE = "propped"
"""How a plate holds the sheet; a part of the name of databases over plates."""
STAGES = "over the stage before, each with its own levels"
"""What a further stage begins with, and what its contours go by; a part of the name of databases of parts that have
one."""


def cached_path(job_file: JobFile) -> Path:
    """Where the database of a job lies in the cache: named by all of the job that its numbers depend on."""
    job = job_file.job
    parts: list[Any] = [ENGINE_VERSION, job_file.material.young_modulus, job_file.material.poisson_ratio]
    path = job.path.model_dump(exclude={"floor_step", "floor_rounds"})  # no numbers are computed on the floor
    parts += [*(part.model_dump() for part in (job.part, job.sheet) if part), path]
    parts += [part.model_dump() for part in (job.tool_1, job_file.rig.clamp)]
    parts += [job.process, None if job.tool_2 is None else job.tool_2.model_dump()]
    parts += [] if job.backing_plate is None else [job.backing_plate.model_dump(), PLATE_EDGE]
    further = job.path.stages or job.path.morph is not None or job.path.finishing_passes
    parts += [STAGES] if further else []
    elastic = job.springback.elastic.model_dump(exclude={"database", "forecast", "block", "engine"})
    parts += [] if job.springback.elastic.engine == "compact" else [job.springback.elastic.engine]
    digest = hashlib.sha256(repr([*parts, elastic]).encode())
    named = [] if job.accuracy_surfaces is None else [job_file.base / job.accuracy_surfaces]
    for source in filter(Path.is_file, [*job_file.sources, *named]):
        digest.update(source.read_bytes())
    return cache_folder() / f"{job.name}-{digest.hexdigest()[:16]}.json"


def database_of(job_file: JobFile) -> Database | None:
    """The database that the job names, else the cached one, else None.

    Raises
    ------
    IsfError : FILE_NOT_FOUND (a named file), DATABASE_UNUSABLE
    """
    named = job_file.job.springback.elastic.database
    if named is not None:
        return Database.load((job_file.base / named).resolve())
    path = cached_path(job_file)
    return Database.load(path) if path.is_file() else None


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write ``data`` so that a reader sees the whole file or none; raises IsfError FILE_NOT_WRITABLE."""
    with replacing(path, make_folder=True, advice="choose another folder, or set ISF_CACHE_DIR") as file:
        file.write(json.dumps(data).encode())
