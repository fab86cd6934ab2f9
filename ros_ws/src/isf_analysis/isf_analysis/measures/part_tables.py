"""One formed part as tables: a row per contour, per contour point, and per control tick.

Columns are SI and carry their unit in the name ("correction_max_m"); contours count from 0 in ``contour``. What is not
known is NaN, of texts empty.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from isf_core.contour import Contour, ContourCorrection, ContourResult
from isf_core.errors import IsfError
from isf_core.types import Array
from numpy.typing import NDArray

from isf_analysis.measures.contour_scan import ScanError, scan_errors
from isf_analysis.measures.expected_error import known_deviation, sizes
from isf_analysis.measures.force_metrics import force_metrics
from isf_analysis.measures.record import PartRecord

NAN = float("nan")

EXPECTED = ("expected_error_mean_m", "expected_error_mean_abs_m", "expected_error_max_m")

Rows = dict[str, NDArray[Any]]
"""Column by name, all of the same length."""


def contour_table(record: PartRecord) -> Rows:
    """One row per contour that was planned: what was planned, corrected, measured, and how it ended.

    ``planned_duration_s`` is without the moves between contours, ``duration_s`` with the approach to this one.
    ``predicted_force_mean_N`` (of the plan) and ``forecast_force_mean_N`` (of the correction) stand beside the measured
    ``axial_force_mean_N``. Of the correction, ``expected_error_mean_m`` is the signed error that it foresees,
    ``expected_error_mean_abs_m`` and ``expected_error_max_m`` are the mean and largest size to expect with its
    uncertainty; beside them ``scan_error_*``, the vertical error on what was formed so far in the scan after this
    contour.
    """
    corrections = {item.index: item for item in record.corrections}
    results = {item.index: item for item in record.results}
    scanned = _scanned(record)
    rows = []
    for contour in record.nominal:
        result = results.get(contour.index)
        rows.append(
            {
                "contour": contour.index,
                **_planned(contour),
                **_corrected(contour, corrections.get(contour.index)),
                **_formed(contour, result),
                **_held(result, record.control_rate),
                **_seen(scanned.get(contour.index)),
            }
        )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}


def point_table(record: PartRecord) -> Rows:
    """One row per contour point: planned, corrected and measured tip of both tools, angles, forces, offsets."""
    corrected = {item.index: item for item in record.corrected}
    corrections = {item.index: item for item in record.corrections}
    results = {item.index: item for item in record.results}
    parts = []
    for contour in record.nominal:
        n, k = len(contour), contour.index
        as_formed, correction, result = corrected.get(k), corrections.get(k), results.get(k)
        part: Rows = {
            "contour": np.full(n, k),
            "point": np.arange(n),
            **_vector("planned_tip", "m", contour.forming_tip, n),
            **_vector("corrected_tip", "m", _of(as_formed, "forming_tip"), n),
            **_vector("target_tip", "m", _of(result, "forming_target"), n),
            **_vector("measured_tip", "m", _of(result, "forming_measured"), n),
            **_vector("planned_support_tip", "m", contour.support_tip, n),
            **_vector("measured_support_tip", "m", _of(result, "support_measured"), n),
            **_vector("contact", "m", contour.contact, n),
            "wall_angle_rad": contour.wall_angle,
            "thickness_m": contour.thickness,
            **_vector("correction", "m", _of(correction, "offset"), n),
            "springback_m": _scalar(_of(correction, "springback"), n),
            "springback_deviation_m": _scalar(_of(correction, "uncertainty"), n),
            "expected_error_m": _scalar(_of(correction, "residual"), n),
            "predicted_force_N": _scalar(contour.predicted_force, n),
            **_vector("forming_force", "N", _of(result, "forming_force"), n),
            "set_point_N": _scalar(contour.support_force, n),
            **_vector("support_force", "N", _of(result, "support_force"), n),
            "force_offset_m": _scalar(_of(result, "force_offset"), n),
            **_vector("compliance_offset", "m", _of(result, "compliance_offset"), n),
        }
        parts.append(part)
    return _below_each_other(parts)


def tick_table(record: PartRecord) -> Rows:
    """One row per control tick of a contour: set-point (NaN: position control) and measured normal force."""
    parts = []
    for result in record.results:
        n = len(result.tick_time)
        parts.append(
            {
                "contour": np.full(n, result.index),
                "time_s": result.tick_time,
                "set_point_N": _scalar(result.tick_set_point, n),
                "normal_force_N": _scalar(result.tick_normal_force, n),
                "engaged": result.tick_engaged if len(result.tick_engaged) == n else np.zeros(n, dtype=bool),
            }
        )
    return _below_each_other(parts)


def _planned(contour: Contour) -> dict[str, Any]:
    length = float(contour.arc_length()[-1])
    if contour.closed:
        length += float(np.linalg.norm(contour.forming_tip[0] - contour.forming_tip[-1]))
    return {
        "feature": contour.feature,
        "stage": contour.stage,
        "process": contour.process.name,
        "forming_tool": contour.forming_tool,
        "points": len(contour),
        "depth_m": float((contour.push_sign * (contour.forming_tip[:, 2] + contour.holder_height)).max()),
        "length_m": length,
        "feed_m_s": contour.feed,
        "planned_duration_s": length / contour.feed,
        "wall_angle_mean_rad": float(contour.wall_angle.mean()),
        "thickness_min_m": float(contour.thickness.min()),
        "predicted_force_mean_N": _mean(contour.predicted_force),
    }


def _corrected(contour: Contour, correction: ContourCorrection | None) -> dict[str, Any]:
    if correction is None:
        numbers = ("correction_mean_m", "correction_max_m", "springback_mean_m", "springback_max_m")
        more = (*EXPECTED, "forecast_force_mean_N", "solve_time_s")
        return {"method": "", "correction_code": 0, **dict.fromkeys((*numbers, *more), NAN)}
    push = contour.push_sign * correction.offset[:, 2]
    left, deviation = correction.residual, known_deviation(correction.uncertainty, len(correction.residual))
    known = np.isfinite(left) & np.isfinite(deviation)
    largest, mean = sizes(left[known], deviation[known])
    return {
        "method": correction.method,
        "correction_code": correction.code,
        "correction_mean_m": _mean(push),
        "correction_max_m": float(np.linalg.norm(correction.offset, axis=1).max(initial=0.0)),
        "springback_mean_m": _mean(correction.springback),
        "springback_max_m": float(np.abs(correction.springback).max()) if len(correction.springback) else NAN,
        **dict(zip(EXPECTED, (_mean(left), mean, largest), strict=True)),
        "forecast_force_mean_N": _mean(correction.control_point_force),
        "solve_time_s": correction.solve_time,
    }


def _formed(contour: Contour, result: ContourResult | None) -> dict[str, Any]:
    if result is None:
        numbers = ("start_s", "end_s", "duration_s", "axial_force_mean_N", "axial_force_max_N", "force_offset_max_m")
        counts = ("code", "saturations", "backoffs", "late_ticks", "lost_messages")
        nothing = {**dict.fromkeys((*numbers, "compliance_offset_max_m"), NAN), **dict.fromkeys(counts, 0)}
        return {"completed": False, **nothing, "message": ""}
    axial = -contour.push_sign * result.forming_force[:, 2] if len(result.forming_force) else np.empty(0)
    return {
        "completed": result.completed,
        "start_s": result.start,
        "end_s": result.end,
        "duration_s": result.end - result.start,
        "axial_force_mean_N": _mean(axial),
        "axial_force_max_N": _largest(axial),
        "force_offset_max_m": _largest(result.force_offset),
        "compliance_offset_max_m": _largest(np.linalg.norm(result.compliance_offset.reshape(-1, 3), axis=1)),
        "code": result.code,
        "message": result.message,
        "saturations": result.saturations,
        "backoffs": result.backoffs,
        "late_ticks": result.late_ticks,
        "lost_messages": result.lost_messages,
    }


def _held(result: ContourResult | None, rate: float) -> dict[str, Any]:
    found = force_metrics([result], rate) if result is not None else None
    return {
        "set_point_N": found.set_point if found else NAN,
        "force_error_mean_N": found.mean_error if found else NAN,
        "force_error_rms_N": found.rms_error if found else NAN,
        "force_error_max_N": found.max_abs_error if found else NAN,
        "within_10N_fraction": found.within_band if found else NAN,
        "engaged_fraction": found.engaged_fraction if found else NAN,
        "contact_fraction": result.contact_fraction if result is not None else NAN,
    }


def _seen(error: ScanError | None) -> dict[str, Any]:
    return {
        "scan_error_mean_m": error.mean if error else NAN,
        "scan_error_mean_abs_m": error.mean_abs if error else NAN,
        "scan_error_max_m": error.max_abs if error else NAN,
        "scan_coverage": error.coverage if error else NAN,
    }


def _scanned(record: PartRecord) -> dict[int, ScanError]:
    if record.target is None or not record.scans:
        return {}
    try:
        return {
            error.index: error for error in scan_errors(record.scans, record.nominal, record.target, record.preforms)
        }
    except IsfError:  # a flat target
        return {}


def _of(item: object, name: str) -> Array | None:
    """Field ``name`` of ``item``; None without one."""
    return getattr(item, name, None)


def _vector(name: str, unit: str, values: Array | None, n: int) -> Rows:
    known = values is not None and values.shape == (n, 3)
    table = values if known and values is not None else np.full((n, 3), NAN)
    return {f"{name}_{axis}_{unit}": table[:, k] for k, axis in enumerate("xyz")}


def _scalar(values: Array | None, n: int) -> Array:
    return values if values is not None and len(values) == n else np.full(n, NAN)


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else NAN


def _largest(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.abs(known).max()) if len(known) else NAN


def _below_each_other(parts: list[Rows]) -> Rows:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}
