"""The numbers of one part as one JSON object, for scripts, for the ``isf`` command and for the report.

The only place where results change from SI to the units people read: mm, N, s, percent stays a fraction.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from isf_core.contour import passes_over_floors
from isf_core.errors import IsfError
from isf_core.events import torn
from isf_core.files.job import ToleranceSpec
from isf_core.simulated_sheet import scans_with_sensor

from isf_analysis.measures.contour_scan import ScanError, left_out, scan_errors
from isf_analysis.measures.deviation import BANDS, Deviation, RegionError, compare
from isf_analysis.measures.expected_error import expected_error, overconfident, reached_over_expected
from isf_analysis.measures.findings import findings
from isf_analysis.measures.force_metrics import ForceMetrics, force_metrics
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.sheet_thickness import sheet_thickness
from isf_analysis.measures.verdict import force_remarks, verdict

MM = 1e3


def summary(
    record: PartRecord,
    reference: PartRecord | None = None,
    *,
    bag: Path | str | None = None,
    report: Path | str | None = None,
) -> dict[str, Any]:
    """JSON-serialisable numbers of ``record``; what is unknown is None.

    With a ``reference`` (the uncorrected part) it holds the reference's own numbers under ``reference``, judged by the
    tolerance of ``record``, and the factors error(reference) / error(record) under ``improvement``.
    """
    return summarise(
        record,
        deviation_of(record),
        reference,
        deviation_of(reference) if reference else None,
        scans=scan_errors_of(record),
        bag=bag,
        report=report,
    )


def summarise(
    record: PartRecord,
    deviation: Deviation | None,
    reference: PartRecord | None = None,
    reference_deviation: Deviation | None = None,
    *,
    scans: tuple[ScanError, ...] = (),
    bag: Path | str | None = None,
    report: Path | str | None = None,
) -> dict[str, Any]:
    """As :func:`summary`, from deviations and errors after ``scans`` that are known already."""
    numbers = _part(record, deviation, record.tolerance)
    numbers["notes"] += [record.tolerance_note] if record.tolerance_note else []
    numbers["scans"] = [_scan(error) for error in scans]
    numbers["expected_error"] = _expected(record, scans, numbers)
    if record.target is not None:
        numbers["notes"] += left_out(record.scans, scans, record.nominal, record.target)
    if reference is not None:
        other = _part(reference, reference_deviation, record.tolerance)
        numbers["reference"] = other
        numbers["improvement"] = _improvement(numbers["deviation"], other["deviation"])
    else:
        numbers["reference"] = None
        numbers["improvement"] = None
    numbers["verdict"] = verdict(numbers)
    numbers["bag"] = None if bag is None else str(bag)
    numbers["report"] = None if report is None else str(report)
    return numbers


def deviation_of(record: PartRecord) -> Deviation | None:
    """Deviation of the scanned part, or None when scan or target were not recorded."""
    if record.scan is None or record.target is None:
        return None
    return compare(record.scan, record.target)


def scan_errors_of(record: PartRecord) -> tuple[ScanError, ...]:
    """Errors after the scans between contours; none without scans, or when the target was not recorded."""
    if record.target is None or not record.scans:
        return ()
    return scan_errors(record.scans, record.nominal, record.target, record.preforms)


def _part(record: PartRecord, deviation: Deviation | None, tolerance: ToleranceSpec) -> dict[str, Any]:
    """Numbers of one part, judged by ``tolerance``."""
    failure = record.failure()
    force = _force(force_metrics(record.results, record.control_rate))
    return {
        "job": record.job_name,
        "process": record.process,
        "correction": record.correction,
        "variant": record.variant,
        "world": record.variant,
        "sealed": record.sealed,
        "seed": record.seed,
        "sheet": dict(record.sheet) or None,
        "software": record.software,
        "complete": failure is None,
        "failure": None if failure is None else {"code": failure[0], "message": failure[1]},
        "torn": torn(record.events) is not None,
        "contours": record.formed,
        "contours_planned": record.planned,
        "floor_passes": len(passes_over_floors(record.nominal)),
        "tolerance": {"shape_mm": MM * tolerance.shape, "share": tolerance.share},
        "deviation": None if deviation is None else _deviation(deviation, tolerance.shape),
        "sheet_thickness": sheet_thickness(record, deviation),
        "force": force,
        "exact_scans": _exact_scans(record),
        "machine": _machine(record),
        "ticks": record.ticks,
        "late_ticks": record.late_ticks,
        "lost_messages": record.lost_messages,
        "saturations": sum(result.saturations for result in record.results),
        "sim_s": _number(record.sim_time),
        "wall_s": _number(record.wall_time),
        "plan_warnings": list(record.plan_warnings),
        "overload": record.overload,
        "notes": [
            *record.notes,
            *(text for text in record.warned.values() if text != record.overload),
            *force_remarks(force),
        ],
        **findings(record, None if deviation is None else deviation.error),
    }


def _expected(record: PartRecord, scans: tuple[ScanError, ...], numbers: dict[str, Any]) -> dict[str, Any]:
    """What the correction expected of wall and base beside what a whole part reached."""
    found = expected_error(record, scans)
    whole = numbers["deviation"] if numbers["complete"] else None
    largest, mean = _number(MM * found.largest), _number(MM * found.mean)
    reached_largest, reached_mean = (whole["max_mm"], whole["mean_abs_mm"]) if whole else (None, None)
    return {
        "largest_mm": largest,
        "mean_mm": mean,
        "stands_on": found.stands_on if found.known else "",
        "not_known": "" if found.known else found.stands_on,
        "reached_largest_mm": reached_largest,
        "reached_mean_mm": reached_mean,
        "reached_over_expected": reached_over_expected(largest, reached_largest),
        "overconfident": overconfident(largest, reached_largest),
    }


def _exact_scans(record: PartRecord) -> list[str]:
    """Scans without the errors of a scanner: of the finished part, which those of a simulated machine are always, and
    those between contours, with which the correction went on; in words that a sentence goes on with."""
    if record.variant < 0 or record.scan is None:
        return []
    try:
        between = bool(record.scans) and record.corrects and not scans_with_sensor(record.job(), record.variant)
    except IsfError:  # of another version
        between = False
    return ["of the finished part", *(["between contours"] if between else [])]


def _machine(record: PartRecord) -> dict[str, Any]:
    if record.axis_error is None:
        return {}
    rms, largest = record.axis_error
    return {"leg_error_um": {"rms": 1e6 * rms, "largest": 1e6 * largest}}


def _deviation(deviation: Deviation, tolerance: float) -> dict[str, Any]:
    regions = {
        name: {
            **_region(region),
            **{f"within_0_{round(1e4 * band)}mm_fraction": deviation.within(band, name) for band in BANDS},
            "within_tolerance_fraction": deviation.within(tolerance, name),
            "table2": deviation.signed[name].table2(),
        }
        for name, region in deviation.regions.items()
    }
    whole = regions["wall_and_base"]
    keys = ("max_mm", "mean_abs_mm", "rms_mm", "mean_mm", "table2")
    return {**{key: whole[key] for key in keys}, "regions": regions}


def _region(region: RegionError) -> dict[str, Any]:
    x, y, e = region.worst
    return {
        "max_mm": _number(MM * region.max_abs),
        "mean_abs_mm": _number(MM * region.mean_abs),
        "rms_mm": _number(MM * region.rms),
        "mean_mm": _number(MM * region.mean),
        "max_normal_mm": _number(MM * region.max_abs_normal),
        "mean_abs_normal_mm": _number(MM * region.mean_abs_normal),
        "worst_mm": [_number(MM * x), _number(MM * y), _number(MM * e)],
        "cells": region.cells,
        "coverage": _number(region.coverage),
    }


def _scan(error: ScanError) -> dict[str, Any]:
    return {
        "contour": error.index,
        "stage": error.stage,
        "max_mm": MM * error.max_abs,
        "mean_abs_mm": MM * error.mean_abs,
        "mean_mm": MM * error.mean,
        "coverage": error.coverage,
    }


def _force(metrics: ForceMetrics | None) -> dict[str, Any] | None:
    if metrics is None:
        return None
    return {
        "set_N": _number(metrics.set_point),
        "set_min_N": _number(metrics.lowest),
        "set_max_N": _number(metrics.highest),
        "mean_error_N": _number(metrics.mean_error),
        "rms_error_N": _number(metrics.rms_error),
        "p99_abs_error_N": _number(metrics.p99_abs_error),
        "p999_abs_error_N": _number(metrics.p999_abs_error),
        "max_abs_error_N": _number(metrics.max_abs_error),
        "within_10N_fraction": _number(metrics.within_band),
        "contact_fraction": _number(metrics.contact_fraction),
        "engaged_s": _number(metrics.engaged_time),
        "engaged_fraction": _number(metrics.engaged_fraction),
    }


def _improvement(after: dict[str, Any] | None, before: dict[str, Any] | None) -> dict[str, float | None] | None:
    """Error of the reference over error of the part; above 1 the part is better."""
    if after is None or before is None:
        return None
    names = {"max": "max_mm", "mean_abs": "mean_abs_mm", "rms": "rms_mm"}
    return {name: _ratio(before[key], after[key]) for name, key in names.items()}


def _ratio(above: float | None, below: float | None) -> float | None:
    return None if above is None or not below else _number(above / below)


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
