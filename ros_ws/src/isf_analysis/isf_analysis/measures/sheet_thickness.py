"""How thick the formed sheet is, where it is thinnest and where it bears least more, and what tells so.

The simulated machine tells the thickness of its sheet and the strain that is left before the forming limit. A real one
does not: there the thickness is estimated as t0 cos(slope) of the smoothed scan, the sine law on the shape as it is,
which holds where a wall was formed in one pass. Without a scan there is the plan's.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_core.view.coloured import value_near_path
from scipy.ndimage import gaussian_filter

from isf_analysis.measures.deviation import Deviation
from isf_analysis.measures.record import PartRecord

MM = 1e3

SMOOTHING = 2e-3
"""m, standard deviation of the filter of the scan: noise of 0.05 mm between points 1 mm apart is a slope of 3 deg."""

SHARE = 0.95
"""Of the formed nodes, for what most of them bear: the seam of the contours, a few per cent, stands apart."""

SIMULATED, ESTIMATED, PLANNED = "simulated sheet", "estimate from the scan", "plan"
"""Where a thickness comes from."""


def estimated_thickness(record: PartRecord, deviation: Deviation | None) -> HeightMap | None:
    """m, t0 cos(slope) of the smoothed scan on the grid of the target, NaN where the scan is; None: cannot be told.

    ``deviation``: of the part. None too where the sheet itself tells its thickness, and where the job does not tell t0.
    """
    blank, target = record.blank_thickness, record.target
    if record.formed_sheet is not None or deviation is None or target is None or blank is None:
        return None
    z = target.z + deviation.error.z
    known = np.isfinite(z)
    sigma = [SMOOTHING / (line[1] - line[0]) for line in (target.y, target.x)]
    weight = gaussian_filter(known.astype(float), sigma)
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = np.where(known, gaussian_filter(np.where(known, z, 0.0), sigma) / weight, np.nan)
    dz_dx, dz_dy = HeightMap(target.x, target.y, smooth).gradient()
    return HeightMap(target.x, target.y, blank / np.sqrt(1.0 + dz_dx**2 + dz_dy**2))


def sheet_thickness(record: PartRecord, deviation: Deviation | None) -> dict[str, Any] | None:
    """JSON: ``source``, ``blank_mm``, and ``thinnest`` and ``least_margin``, a place each; None where nothing tells it.

    A place has ``thickness_mm``, ``place_mm`` [x, y, z], ``planned_mm`` (of the contact of the last stage that is
    nearest in plan, None beside the path) and ``margin`` (None where it is not known). ``most_bear``: the strain margin
    that SHARE of the nodes beside the path have at least, None where it is not known.
    """
    sheet = record.formed_sheet
    if sheet is not None:
        source, points, thickness = SIMULATED, sheet.points.reshape(-1, 3), sheet.thickness.ravel()
        margin = sheet.strain_margin.ravel()
    elif (estimate := estimated_thickness(record, deviation)) is not None and deviation is not None:
        inside = deviation.masks["wall_and_base"] & np.isfinite(estimate.z)
        source, thickness = ESTIMATED, estimate.z[inside]
        z = deviation.error.z + (record.target.z if record.target is not None else 0.0)
        points = HeightMap(estimate.x, estimate.y, z).points()[inside.ravel()]
        margin = np.full(len(thickness), np.nan)
    elif record.last_stage:
        source, points = PLANNED, np.vstack([contour.contact for contour in record.last_stage])
        thickness = np.concatenate([contour.thickness for contour in record.last_stage])
        margin = np.full(len(thickness), np.nan)
    else:
        return None
    if not np.isfinite(thickness).any():
        return None
    planned = _planned(record, points[:, :2])
    formed = margin[np.isfinite(planned) & np.isfinite(margin)]

    def place(node: np.intp) -> dict[str, Any]:
        return {
            "thickness_mm": _number(MM * thickness[node]),
            "place_mm": [_number(MM * value) for value in points[node]],
            "planned_mm": _number(MM * planned[node]),
            "margin": _number(margin[node]),
        }

    blank = record.blank_thickness
    return {
        "source": source,
        "blank_mm": None if blank is None else MM * blank,
        "thinnest": place(np.nanargmin(thickness)),
        "least_margin": place(np.nanargmin(margin)) if np.isfinite(margin).any() else None,
        "most_bear": float(np.quantile(formed, 1.0 - SHARE)) if len(formed) else None,
    }


def _planned(record: PartRecord, places: Array) -> Array:
    """(M,) m, planned thickness at ``places`` (M, 2) m; NaN beside the path."""
    contours = record.last_stage
    if not contours:
        return np.full(len(places), np.nan)
    return value_near_path(contours, [one.thickness for one in contours], places)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
