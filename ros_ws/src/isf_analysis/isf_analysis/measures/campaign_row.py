"""One simulated part of a campaign as a row of its table: how it ended, its numbers, and what they rest on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.simulated_sheet import SEALED_VARIANTS
from numpy.typing import NDArray

from isf_analysis.measures.expected_error import expected_error, overconfident, reached_over_expected
from isf_analysis.measures.force_metrics import force_metrics
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import MM, deviation_of, scan_errors_of


@dataclass(frozen=True)
class CampaignRow:
    """Errors are vertical, in the clamp, formed minus target, in mm; None where there is none.

    Attributes
    ----------
    job, method, variant, seed, sheet : what was formed
    key, sources : name by content, digest of the sources it was computed by ; software : version
    process, control_rate_Hz, tolerance_mm : of the job
    code, message : of what ended the part early or refused it; 0 for a whole part, and that its machine may not bear it
    contours, planned : formed, and of how many
    max_mm, mean_mm, signed_mm, p95_mm, within_tolerance : of wall and base; the last is a share of the points
    wall_*, base_*, rim_* : the same of these regions
    expected_max_mm, expected_mean_mm : that the correction expected of wall and base; None where it cannot tell
    mark_spacing_mm, scallop_um : tool marks that the plan leaves on 95 % of the walls, and the ridges between them
    force_rms_N : error of the support force while the loop was in full control
    sim_s, wall_s, cpu_s : of the machine, of the computer, of its processor
    """

    job: str
    method: str
    variant: int
    seed: int
    sheet: str
    key: str
    sources: str
    software: str
    process: str = ""
    control_rate_Hz: float | None = None  # noqa: N815 - columns carry their unit
    tolerance_mm: float | None = None
    code: int = 0
    message: str = ""
    contours: int = 0
    planned: int = 0
    max_mm: float | None = None
    mean_mm: float | None = None
    signed_mm: float | None = None
    p95_mm: float | None = None
    within_tolerance: float | None = None
    wall_max_mm: float | None = None
    wall_mean_mm: float | None = None
    base_max_mm: float | None = None
    base_mean_mm: float | None = None
    base_signed_mm: float | None = None
    rim_max_mm: float | None = None
    rim_signed_mm: float | None = None
    expected_max_mm: float | None = None
    expected_mean_mm: float | None = None
    mark_spacing_mm: float | None = None
    scallop_um: float | None = None
    force_rms_N: float | None = None  # noqa: N815
    sim_s: float | None = None
    wall_s: float | None = None
    cpu_s: float | None = None

    @property
    def whole(self) -> bool:
        """The part was formed to its end and measured."""
        return self.code == 0 and self.max_mm is not None

    @property
    def reached_over_expected(self) -> float | None:
        """Of the largest error of a whole part; None where nothing was expected."""
        return reached_over_expected(self.expected_max_mm, self.max_mm) if self.whole else None

    @property
    def overconfident(self) -> bool:
        """The whole part came out worse than expected by more than a factor of 1.5."""
        return self.whole and bool(overconfident(self.expected_max_mm, self.max_mm))

    @property
    def overload(self) -> str:
        """That the whole part took more than its machine bears, for people; empty: it did not."""
        return self.message if self.whole else ""

    @property
    def sealed(self) -> bool:
        """Its variant is kept to publish results with."""
        return self.variant in SEALED_VARIANTS

    @property
    def ending(self) -> str:
        """How a part that is not whole ended: code, name and place."""
        if self.code == 0:
            return "not measured"
        name = ErrorCode(self.code).name if self.code in set(ErrorCode) else ""
        place = f" at contour {self.contours + 1} of {self.planned}" if self.planned else ""
        return f"{self.code} {name}{place}".strip()


def row_from(data: Mapping[str, Any]) -> CampaignRow | None:
    """The row that :func:`dataclasses.asdict` made; None for one of another layout."""
    try:
        return CampaignRow(**data)
    except TypeError:
        return None


def measured(row: CampaignRow, record: PartRecord) -> dict[str, Any]:
    """Fields of ``row`` with ending and numbers of its part."""
    failure = record.failure()
    force = force_metrics(record.results, record.control_rate)
    data = asdict(row) | {
        "process": record.process,
        "contours": record.formed,
        "planned": record.planned,
        "code": failure[0] or int(ErrorCode.BAG_INCOMPLETE) if failure else 0,
        "message": failure[1] if failure else record.overload,
        "force_rms_N": _number(force.rms_error) if force else None,
        "sim_s": round(record.sim_time, 2),
    }
    try:
        deviation = deviation_of(record)
    except IsfError as error:  # nothing in common with the target
        return data | {"code": data["code"] or int(error.code), "message": data["message"] or error.message}
    if deviation is None:
        return data
    size = np.abs(deviation.errors())
    expected = expected_error(record, scan_errors_of(record))
    found = {
        "expected_max_mm": MM * expected.largest,
        "expected_mean_mm": MM * expected.mean,
        "p95_mm": MM * np.percentile(size, 95) if len(size) else np.nan,
        "within_tolerance": deviation.within(record.tolerance.shape),
    }
    for prefix, name in (("", "wall_and_base"), ("wall_", "wall"), ("base_", "base"), ("rim_", "rim")):
        region = deviation.regions[name]
        values = {"max": region.max_abs, "mean": region.mean_abs, "signed": region.mean}
        found |= {f"{prefix}{kind}_mm": MM * value for kind, value in values.items()}
    return data | {name: _number(value) for name, value in found.items() if name in data}


def columns_of(rows: Iterable[CampaignRow]) -> dict[str, NDArray[Any]]:
    """The table: texts as objects, whole numbers, and numbers with NaN where there is none."""
    kinds: dict[str, Any] = {"str": object, "int": np.int64}
    table = [asdict(row) for row in rows]
    found = {}
    for field in fields(CampaignRow):
        kind = kinds.get(str(field.type), np.float64)
        found[field.name] = np.array([row[field.name] for row in table], dtype=kind)
    return found


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 5)
