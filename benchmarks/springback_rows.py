"""One run of the springback table: what it depends on, its numbers, and the file that keeps them.

A row is named by its content: the job with mesh, die, rig and material, the method, the world, and the sources of the
packages that computed it. So a campaign goes on after it was stopped, and nothing computed by other sources is taken
for present. Lengths in rows are mm, forces N.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from isf_analysis.measures.deviation import BANDS, Deviation, compare
from isf_analysis.measures.expected_error import expected_error, overconfident, reached_over_expected
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import MM, scan_errors_of
from isf_cell import in_process
from isf_cell.campaign.content import job_content
from isf_cell.options import RunOptions
from isf_core.errors import IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from numpy.typing import NDArray
from springback import PUSHED, Case, job_of, with_database

REGIONS = ("wall_and_base", "base", "wall", "walls_base", "rim", "flange")
"""Those of isf_analysis.measures.deviation, and walls with base but without the fillets between them."""


def key(case: Case, job_file: JobFile, digest: str) -> str:
    """Name of the row of ``case`` computed by the sources ``digest``."""
    sheet = "" if case.sheet == "fast" else f"{case.sheet} "
    text = f"{job_content(job_file)} {case.method} {case.world} {sheet}{digest}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def run(case: Case, name: str, digest: str, maps: Path) -> dict[str, Any]:
    """Row of one run; the shape of the nominal world goes to ``maps``. A job that is refused is a row too."""
    row: dict[str, Any] = {**vars(case), "key": name, "sources": digest, "code": 0, "message": ""}
    started, used = time.perf_counter(), time.process_time()
    try:
        job_file, method = job_of(case)
        if case.method.endswith(PUSHED):
            with_database(job_file)
        # the standard worlds are those of seed 0
        options = RunOptions(correction=method, variant=case.world, seed=0, sheet=case.sheet)
        record = in_process.form(job_file, options)
    except IsfError as error:
        return {**row, "code": int(error.code), "message": str(error), "contours": 0, "planned": 0}
    row["rig_N"] = job_file.rig.limits.force[2]
    row["wall_s"], row["cpu_s"] = round(time.perf_counter() - started, 1), round(time.process_time() - used, 1)
    row |= {name: record.sheet[name] for name in ("elements", "kinetic_over_plastic") if name in record.sheet}
    shape = _shape(record, maps / f"{name}.npz" if case.world == 0 else None)
    return {**row, **numbers(record), **shape, "expected": _expected(record)}


def _expected(record: PartRecord) -> dict[str, float] | None:
    """What the correction expected of wall and base: largest and mean error, mm; None: not known."""
    found = expected_error(record, scan_errors_of(record))
    return {"max": round(MM * found.largest, 4), "mean": round(MM * found.mean, 4)} if found.known else None


def ratio(row: dict[str, Any]) -> float | None:
    """Reached over expected largest error of a whole part; None where one of them is not known."""
    expected, reached = row.get("expected"), row.get("wall_and_base")
    if row["code"] or not expected or not reached:
        return None
    return reached_over_expected(expected["max"], reached["max"])


def is_overconfident(row: dict[str, Any]) -> bool:
    """True of a whole part whose largest error is more than 1.5 times what was expected."""
    found = ratio(row)
    return bool(found is not None and overconfident(1.0, found))


def numbers(record: PartRecord) -> dict[str, Any]:
    """Contours, ending and forces of a run."""
    failure = record.failure()
    axial = [np.abs(result.forming_force[:, 2]) for result in record.results if result.forming_force.size]
    forces = [float(np.nanmean(force)) for force in axial if np.isfinite(force).any()]
    return {
        "contours": record.formed,
        "planned": record.planned,
        "code": failure[0] if failure else 0,
        "message": failure[1] if failure else "",
        "force_N": round(max(forces, default=float("nan")), 1),
        "sim_s": round(record.sim_time, 1),
    }


def _shape(record: PartRecord, path: Path | None) -> dict[str, Any]:
    if record.scan is None or record.target is None:
        return {}
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **_packed("scan", record.scan), **_packed("target", record.target))
    return measures(compare(record.scan, record.target))


def measures(deviation: Deviation) -> dict[str, dict[str, float]]:
    """Per region: largest, mean and signed mean error, 95th percentile, mm; share of points within 0.3 mm."""
    masks = {**deviation.masks, "walls_base": deviation.masks["wall"] | deviation.masks["base"]}
    found: dict[str, dict[str, float]] = {}
    for region in REGIONS:
        error = MM * deviation.error.z[masks[region] & np.isfinite(deviation.error.z)]
        if len(error):
            size = np.abs(error)
            values = {
                "max": float(size.max()),
                "mean": float(size.mean()),
                "signed": float(error.mean()),
                "p95": float(np.percentile(size, 95)),
                "share": float(np.mean(size <= MM * BANDS[-1])),
            }
            found[region] = {name: round(value, 4) for name, value in values.items()}
    return found


def _packed(name: str, shape: HeightMap) -> dict[str, NDArray[np.float32]]:
    return {f"{name}_{axis}": np.asarray(getattr(shape, axis), dtype=np.float32) for axis in ("x", "y", "z")}


def shapes(path: Path) -> tuple[Deviation, HeightMap] | None:
    """Deviation and target kept by :func:`run`, or None."""
    if not path.is_file():
        return None
    with np.load(path) as data:
        scan, target = (
            HeightMap(*(np.asarray(data[f"{name}_{axis}"], dtype=np.float64) for axis in ("x", "y", "z")))
            for name in ("scan", "target")
        )
    return compare(scan, target), target


def worlds(texts: Iterable[str]) -> list[int]:
    """Numbers of worlds from texts such as 0, 1-20 or 3,5.

    Raises
    ------
    ValueError : something else
    """
    found: list[int] = []
    for text in ",".join(texts).split(","):
        first, _, last = text.partition("-")
        found += range(int(first), int(last or first) + 1)
    return list(dict.fromkeys(found))


def sheet_of(row: dict[str, Any]) -> str:
    """Model of the sheet of a row; the fast one where it was not written yet."""
    return str(row.get("sheet", "fast"))


def of(rows: Iterable[dict[str, Any]], job: str, method: str) -> list[dict[str, Any]]:
    """Rows of a part and a method by world; of a world with several the one kept last."""
    by_world = {row["world"]: row for row in rows if row["job"] == job and row["method"] == method}
    return [by_world[world] for world in sorted(by_world)]


def latest(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of every case the row kept last, whatever its sources."""
    return list({(row["job"], row["method"], row["world"], sheet_of(row)): row for row in rows}.values())
