"""What the messages of a part tell beyond its shape, as JSON: events, remarks, outlook, force by region, time.

Units are those people read: mm, N, s; fractions stay fractions. What is unknown is None.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from isf_core.events import kind_name
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array

from isf_analysis.measures import events, remarks
from isf_analysis.measures.error_split import error_splits
from isf_analysis.measures.force_regions import (
    REGIONS,
    ContactLoss,
    PathForce,
    RegionForce,
    contact_losses,
    path_forces,
    region_forces,
)
from isf_analysis.measures.process_time import process_time
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.release import movement_of

MM = 1e3


def findings(record: PartRecord, error: HeightMap | None) -> dict[str, Any]:
    """The keys this adds to the summary of ``record``; ``error``: vertical deviation of the finished part, m."""
    paths = path_forces(record.results, record.corrected)
    return {
        "events": [_group(group, record) for group in events.groups(record.events, record.results)],
        "remarks": [
            {"text": item.text, "contours": list(item.contours), "failed": item.failed}
            for item in remarks.grouped(record.corrections)
        ],
        "outlook": _outlook(record, error),
        "error_split": _error_split(record, error),
        "force_regions": {name: _region(region) for name, region in region_forces(paths).items()} or None,
        "contact_losses": _losses(paths),
        "time": _time(record),
        "backoffs": sum(result.backoffs for result in record.results),
    }


def _group(group: events.EventGroup, record: PartRecord) -> dict[str, Any]:
    first = group.first
    return {
        "kind": kind_name(group.kind),
        "count": group.count,
        "harmless": group.harmless,
        "first": {
            "time_s": _number(first.time),
            "contour": events.contour_at(record.results, first.time),
            "position_mm": [_number(MM * value) for value in first.position],
        },
        "value": _number(group.value),
        "limit": _number(group.limit),
        "text": group.text,
    }


def reached_errors(record: PartRecord, error: HeightMap) -> dict[int, Array]:
    """m, by index of the contours whose correction told what will remain: ``error`` of the finished part where it did.

    Of the last stage: what an earlier one leaves is formed again. (N,) as the residual, NaN at points of which either
    is unknown.
    """
    contours = {contour.index: contour for contour in record.last_stage}
    return {
        item.index: np.where(np.isfinite(item.residual), error.at(contours[item.index].contact[:, :2]), np.nan)
        for item in record.corrections
        if len(item.residual) and item.index in contours and len(contours[item.index]) == len(item.residual)
    }


def _outlook(record: PartRecord, error: HeightMap | None) -> dict[str, Any] | None:
    """What the correction expected to be wrong with itself: over all points, and of the last contour that told.

    Of the last stage, and beside it what was reached at the same points.
    """
    earlier = {contour.index for contour in record.nominal} - {contour.index for contour in record.last_stage}
    told = [item for item in record.corrections if item.index not in earlier]
    residual = [item.residual for item in told if len(item.residual)]
    spread = [item.uncertainty for item in told if len(item.uncertainty)]
    if not residual and not spread:
        return None
    left = np.concatenate(residual) if residual else np.empty(0)
    reached = list(reached_errors(record, error).values()) if error is not None else []
    found = np.concatenate(reached) if reached else np.empty(0)
    doubt = np.concatenate(spread) if spread else np.empty(0)
    return {
        "residual_mean_mm": _mean(left),
        "residual_max_abs_mm": _largest(left),
        "residual_last_mean_mm": _mean(residual[-1]) if residual else None,
        "reached_mean_mm": _mean(found),
        "reached_max_abs_mm": _largest(found),
        "reached_last_mean_mm": _mean(reached[-1]) if reached else None,
        "uncertainty_mean_mm": _mean(doubt),
        "uncertainty_max_mm": _largest(doubt),
    }


def _error_split(record: PartRecord, error: HeightMap | None) -> dict[str, Any] | None:
    """Terms of the error over all points of the contours; None for a part of whose error or tips nothing is known."""
    splits = error_splits(record, error, movement_of(record)) if error is not None else ()
    if not splits:
        return None
    terms = ("correction", "tool", "followed", "deflected", "sheet", "error", "support", "released")
    found = {name: np.concatenate([getattr(split, name) for split in splits]) for name in terms}
    return {
        "contours": len(splits),
        **{
            name: {
                "mean_mm": _mean(values),
                "rms_mm": _rms(values),
                "max_abs_mm": _largest(values),
            }
            for name, values in found.items()
        },
    }


def _time(record: PartRecord) -> dict[str, Any] | None:
    found = process_time(record)
    if found is None:
        return None
    return {
        "contours": found.contours,
        "planned_s": found.planned,
        "actual_s": found.actual,
        "slowed_s": found.slowed,
        "force_ramps_s": _number(found.force_ramps),
        "force_control_s": _number(found.force_control),
        "rest_s": found.rest,
        "between_s": found.between,
        "slowest_contour": found.slowest,
        "slowest_excess_s": found.slowest_excess,
    }


def _region(region: RegionForce) -> dict[str, Any]:
    return {
        "points": region.points,
        "share": _number(region.share),
        "contact_lost_fraction": _number(region.lost_share),
        "mean_error_N": _number(region.mean_error),
        "rms_error_N": _number(region.rms_error),
        "p99_abs_error_N": _number(region.p99_abs_error),
        "max_abs_error_N": _number(region.max_abs_error),
        "within_10N_fraction": _number(region.within_band),
    }


def _losses(paths: tuple[PathForce, ...]) -> dict[str, Any] | None:
    if not paths:
        return None
    losses = contact_losses(paths)
    longest = max(losses, key=lambda loss: loss.length, default=None)
    return {
        "count": len(losses),
        "length_mm": _number(MM * math.fsum(loss.length for loss in losses)),
        "path_mm": _number(MM * math.fsum(path.length for path in paths)),
        "begun_in": {name: sum(loss.region == name for loss in losses) for name in REGIONS},
        "longest": None if longest is None else _loss(longest),
    }


def _loss(loss: ContactLoss) -> dict[str, Any]:
    return {
        "contour": loss.contour,
        "length_mm": _number(MM * loss.length),
        "start_mm": [_number(MM * value) for value in loss.start],
        "region": loss.region,
    }


def _mean(values: Any) -> float | None:
    """mm, mean of lengths in m; None when nothing is known."""
    known = values[np.isfinite(values)]
    return float(MM * known.mean()) if len(known) else None


def _rms(values: Array) -> float | None:
    """mm, root mean square of lengths in m; None when nothing is known."""
    known = values[np.isfinite(values)]
    return float(MM * np.sqrt(np.mean(known**2))) if len(known) else None


def _largest(values: Array) -> float | None:
    """mm, largest size of lengths in m; None when nothing is known."""
    known = values[np.isfinite(values)]
    return float(MM * np.abs(known).max()) if len(known) else None


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
