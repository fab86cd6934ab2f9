"""What accuracy surfaces are learned from: places of formed parts with their deviation, in one file.

The file is numpy's npz without pickled objects. It holds samples and no fitted model: that is fitted when the file is
used, so a file can be added to, and does not depend on the version of a library.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from isf_core.contour import Contour, makes_floor, passes_over_floors
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.archive import read_archive
from isf_core.files.bounded import reason
from isf_core.files.job import Job, floor_step
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_planner.accuracy.places import PREDICTORS, find_places, nodes_of

FORMAT = 2
"""2: with how the parts were compensated, staged and supported."""

MOST_SAMPLES = 800
"""Places that are kept of a part."""

LEAST_SEEN = 0.5
"""Share of the part that must have been measured."""

SAME_THICKNESS = 0.02
"""A blank may be thinner or thicker than those learned by this share: rolling tolerance (assumed)."""

PLANNED_METHODS = ("none", "analytic", "elastic")
"""Springback methods that do not look at the part while it is formed: one that does would work against a moved
target."""

_ADVICE = "make it with: isf learn RUN... --surfaces -o FILE"


@dataclass(frozen=True)
class Conditions:
    """What must be the same for parts to be learned from together, and for a part to be planned from them.

    Attributes
    ----------
    process : SPIF or DSIF ; material : of the sheet ; tool_radius : m, of the upper tool's tip
    correction : springback method ; plate : there is a backing plate
    compensation : what the plan compensated, in alphabetical order
    stages : shapes were formed before the part ; finishing_passes : after it
    on_blank : the support tool stayed under the blank
    floor_passes : the tool passed over the floors that are flat
    """

    process: str
    material: str
    tool_radius: float
    correction: str
    plate: bool
    compensation: tuple[str, ...] = ()
    stages: bool = False
    finishing_passes: int = 0
    on_blank: bool = False
    floor_passes: bool = False

    @staticmethod
    def of(job: Job, correction: str | None = None, planned: Sequence[Contour] = ()) -> Conditions:
        """Of a job, formed with the springback method ``correction``, None: the job's, and of a part that was formed on
        ``planned`` contours: what a job of then leaves open may have been planned otherwise."""
        method = job.springback.method if correction is None else correction or "none"
        passed = floor_step(job) is not None
        if any(makes_floor(contour) for contour in planned):
            passed = bool(passes_over_floors(planned))
        return Conditions(
            job.process,
            Path(job.sheet.material).stem,
            job.tool_1.ball_radius,
            method,
            plate=job.backing_plate is not None,
            compensation=tuple(sorted(job.path.compensation)),
            stages=bool(job.path.stages) or job.path.morph is not None,
            finishing_passes=job.path.finishing_passes,
            on_blank=job.support_stays,
            floor_passes=passed,
        )

    def difference(self, other: Conditions) -> str:
        """What differs, for people; empty: nothing."""
        mine, others = self._words(), other._words()
        return ", ".join(f"{mine[name]} instead of {others[name]}" for name in mine if mine[name] != others[name])

    def _words(self) -> dict[str, str]:
        return {
            "process": self.process,
            "material": self.material,
            "tool": f"a tool radius of {1e3 * self.tool_radius:.2f} mm",
            "correction": f"springback method {self.correction}",
            "plate": "a backing plate" if self.plate else "no backing plate",
            "compensation": f"compensation of {' and '.join(self.compensation) or 'nothing'} in the plan",
            "stages": "stages before the part" if self.stages else "no stages before the part",
            "finishing_passes": f"{self.finishing_passes} finishing passes",
            "floor_passes": f"{'passes' if self.floor_passes else 'no passes'} over the floors",
            "support": f"the support tool {'under the blank' if self.on_blank else 'opposite the contact'}",
        }


@dataclass(frozen=True)
class FormedPart:
    """Places of one part that was formed and measured; S of them.

    Attributes
    ----------
    name : of its job ; shape : the same for parts of the same target ; thickness : m, of its blank
    values : (S, P) of :data:`isf_planner.accuracy.places.PREDICTORS`
    deviation : (S,) m, along the normal of the target, positive too shallow
    weight : (S,) share of the surface that a place stands for
    left : m, root mean square of what a prediction from the other shapes leaves of the deviation; NaN: not known
    """

    name: str
    shape: str
    thickness: float
    values: Array
    deviation: Array
    weight: Array
    left: float = float("nan")

    def rms(self, values: Array) -> float:
        """Root mean square of ``values`` (S,) by surface."""
        return float(np.sqrt(self.weight @ values**2))


@dataclass(frozen=True)
class FormedParts:
    """Parts formed under the same conditions."""

    conditions: Conditions
    parts: tuple[FormedPart, ...]

    @property
    def shapes(self) -> tuple[str, ...]:
        """Different targets, in the order of their first part."""
        return tuple(dict.fromkeys(part.shape for part in self.parts))

    @property
    def uncertainty(self) -> float:
        """m, root mean square error of the prediction of held-out parts, every part alike."""
        return float(np.sqrt(np.mean([part.left**2 for part in self.parts])))

    def check(self, job: Job, where: str) -> None:
        """Raise IsfError LEARNING_UNUSABLE when ``job`` is of other conditions; ``where`` names the file."""
        advice = "name the springback method of those parts, learn from others, or leave part.accuracy_surfaces out"
        if other := Conditions.of(job).difference(self.conditions):
            raise IsfError(
                ErrorCode.LEARNING_UNUSABLE, f"was learned under other conditions: {other}", where=where, advice=advice
            )
        low, high = (limit([part.thickness for part in self.parts]) for limit in (min, max))
        if not (1.0 - SAME_THICKNESS) * low <= job.sheet.thickness <= (1.0 + SAME_THICKNESS) * high:
            learned = f"{1e3 * low:g} mm" if low == high else f"{1e3 * low:g} to {1e3 * high:g} mm"
            raise IsfError(
                ErrorCode.LEARNING_UNUSABLE,
                f"was learned on blanks of {learned}, this one is {1e3 * job.sheet.thickness:g} mm thick",
                where=where,
                advice=advice,
            )


def formed_part(name: str, target: HeightMap, measured: HeightMap, radius: float, thickness: float) -> FormedPart:
    """Places and deviation of one part.

    Parameters
    ----------
    target, measured : m, in frame ``sheet``, flange at z = 0 ; radius : m, of the tool ; thickness : m, of the blank

    Raises
    ------
    IsfError : LEARNING_UNUSABLE, the target forms nothing below its flange or rises above it, too little was measured
    """
    places = None if rises(target) else find_places(target, radius, thickness)
    if places is None:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            "the part does not lie below its flange alone",
            where=name,
            advice="accuracy surfaces are for parts that the upper tool forms alone",
        )
    points, nodes = places.heights.points(), nodes_of(places)
    error = (measured.at(points[nodes, :2]) - points[nodes, 2]) * places.normal[nodes, 2]
    seen = np.isfinite(error)
    if seen.mean() < LEAST_SEEN:
        raise IsfError(
            ErrorCode.LEARNING_UNUSABLE,
            f"{seen.mean():.0%} of the part was measured, {LEAST_SEEN:.0%} are needed",
            where=name,
            advice="scan the whole part",
        )
    nodes, error = nodes[seen], error[seen]
    kept = np.random.default_rng(0).permutation(len(nodes))[:MOST_SAMPLES]
    nodes, error = nodes[kept], error[kept]
    weight = 1.0 / np.maximum(places.normal[nodes, 2], 0.05)
    digest = hashlib.sha256(np.round(1e5 * np.nan_to_num(places.heights.z)).astype(np.int64).tobytes()).hexdigest()
    return FormedPart(name, digest[:16], thickness, places.values[nodes], error, weight / weight.sum())


def rises(target: HeightMap) -> bool:
    """Something of ``target`` (flange at z = 0) stands above its flange."""
    return bool(np.nanmax(target.z) > 0.05e-3)


def save(formed: FormedParts, path: Path) -> None:
    """Write ``formed``; raises IsfError FILE_NOT_WRITABLE."""
    parts, conditions = formed.parts, formed.conditions
    values: dict[str, Any] = {
        "format": np.asarray(FORMAT),
        "kind": np.asarray("accuracy surfaces"),
        "predictors": np.asarray(PREDICTORS),
        "process": np.asarray(conditions.process),
        "material": np.asarray(conditions.material),
        "tool_radius": np.asarray(conditions.tool_radius),
        "correction": np.asarray(conditions.correction),
        "plate": np.asarray(conditions.plate),
        "compensation": np.asarray(conditions.compensation, dtype=np.str_),
        "stages": np.asarray(conditions.stages),
        "finishing_passes": np.asarray(conditions.finishing_passes),
        "on_blank": np.asarray(conditions.on_blank),
        "floor_passes": np.asarray(conditions.floor_passes),
        "name": np.asarray([part.name for part in parts]),
        "shape": np.asarray([part.shape for part in parts]),
        "thickness": np.asarray([part.thickness for part in parts]),
        "left": np.asarray([part.left for part in parts]),
        "count": np.asarray([len(part.deviation) for part in parts]),
        "values": np.vstack([part.values for part in parts]),
        "deviation": np.concatenate([part.deviation for part in parts]),
        "weight": np.concatenate([part.weight for part in parts]),
    }
    try:
        with path.open("wb") as stream:
            np.savez_compressed(stream, **values)
    except OSError as error:
        raise IsfError(ErrorCode.FILE_NOT_WRITABLE, f"cannot be written: {error}", where=str(path)) from error


def load(path: Path) -> FormedParts:
    """Read a file of :func:`save`; raises IsfError LEARNING_UNUSABLE."""
    try:
        read = read_archive(path)
        if "kind" not in read or str(read["kind"]) != "accuracy surfaces":
            raise ValueError("it holds no accuracy surfaces")
        if int(read["format"]) < FORMAT:
            raise ValueError(
                "it is of an older version of this software and does not tell what was compensated, stages, finishing "
                "passes and support of its parts: learn from their runs again"
            )
        if int(read["format"]) != FORMAT or tuple(read["predictors"]) != PREDICTORS:
            raise ValueError("it is of another version of this software")
        conditions = Conditions(
            str(read["process"]),
            str(read["material"]),
            float(read["tool_radius"]),
            str(read["correction"]),
            bool(read["plate"]),
            tuple(map(str, read["compensation"])),
            bool(read["stages"]),
            int(read["finishing_passes"]),
            bool(read["on_blank"]),
            bool(read.get("floor_passes", False)),  # no job passed over floors by itself when it was not kept
        )
        ends = np.cumsum(read["count"])
        if ends[-1] != len(read["values"]) or len(read["deviation"]) != ends[-1] or len(read["weight"]) != ends[-1]:
            raise ValueError("its arrays do not fit together")
        if read["values"].shape[1] != len(PREDICTORS) or not all(
            np.isfinite(read[name]).all() for name in ("values", "deviation", "weight", "thickness")
        ):
            raise ValueError("its arrays do not fit together")
        pieces = [np.split(read[name], ends[:-1]) for name in ("values", "deviation", "weight")]
        heads = zip(read["name"], read["shape"], read["thickness"], *pieces, read["left"], strict=True)
        parts = tuple(
            FormedPart(str(name), str(shape), float(thickness), values, deviation, weight, float(left))
            for name, shape, thickness, values, deviation, weight, left in heads
        )
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:  # arrays of other types and shapes
        text = "no such file" if isinstance(error, FileNotFoundError) else f"cannot be used: {reason(error)}"
        raise IsfError(ErrorCode.LEARNING_UNUSABLE, text, where=str(path), advice=_ADVICE) from error
    return FormedParts(conditions, parts)
