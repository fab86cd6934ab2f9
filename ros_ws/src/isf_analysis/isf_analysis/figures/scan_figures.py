"""Figures of the scans made between contours: how the error of what is formed so far went, and where it lay."""

from __future__ import annotations

import numpy as np
from isf_core.contour import contour_label
from isf_core.geometry.height_map import HeightMap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from isf_analysis.figures import style
from isf_analysis.figures.error_map import draw_errors, draw_opening
from isf_analysis.measures.contour_scan import ScanError

MM = 1e3
MAPS = 4
"""Maps drawn at most, evenly over the scans, the last one among them."""
MARGIN = 5e-3
"""m of flange shown around what is formed."""


def scan_curves(errors: tuple[ScanError, ...]) -> Figure:
    """Largest, mean and signed mean error of what was formed so far, scan by scan."""
    figure = style.new_figure(3.9)
    axes = figure.subplots()
    number = np.array([error.index + 1 for error in errors])
    marker = "o" if len(errors) < 30 else ""
    for attribute, colour, dashes, label in (
        ("max_abs", style.LIMIT, "solid", "largest"),
        ("mean_abs", style.PART, "solid", "mean"),
        ("mean", style.PREDICTION, (0, (4, 2)), "mean with its sign"),
    ):
        values = [MM * getattr(error, attribute) for error in errors]
        axes.plot(number, values, color=colour, linestyle=dashes, marker=marker, markersize=4, label=label)
    axes.axhline(0.0, color=style.TARGET, linewidth=0.9)
    axes.set_xlabel("contour after which the scan was made")
    axes.set_ylabel("error of the part so far [mm]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    style.legend_above(axes, 3)
    return figure


def scan_maps(errors: tuple[ScanError, ...], target: HeightMap) -> Figure:
    """Maps of the error of what was formed so far, up to four of them, with the same colours."""
    chosen = [errors[k] for k in np.unique(np.linspace(0, len(errors) - 1, MAPS + 1).round().astype(int)[1:])]
    limit = style.rounded_limit(max(MM * float(np.nanpercentile(np.abs(error.error.z), 99)) for error in chosen))
    columns = min(2, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = style.new_figure(1.2 + (3.1 if columns == 2 else 5.0) * rows, maps=True)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    x, y = MM * target.x, MM * target.y
    inside = np.any([np.isfinite(error.error.z) for error in errors], axis=0)
    inside_rows, inside_columns = np.nonzero(inside)
    image = None
    for axes, error in zip(panels.ravel(), chosen, strict=False):
        image = draw_errors(axes, error.error, limit)
        draw_opening(axes, target)
        of_stage = f", stage {error.stage + 1}" if errors[-1].stage else ""
        axes.set_title(f"after {contour_label(error.index)}{of_stage}")
        axes.set_xlim(x[inside_columns.min()] - MM * MARGIN, x[inside_columns.max()] + MM * MARGIN)
        axes.set_ylim(y[inside_rows.min()] - MM * MARGIN, y[inside_rows.max()] + MM * MARGIN)
        axes.set_aspect("equal")
        axes.grid(visible=False)
    for axes in panels.ravel()[len(chosen) :]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("x [mm]")
    for axes in panels[:, 0]:
        axes.set_ylabel("y [mm]")
    if image is not None:
        bar = figure.colorbar(image, ax=panels, location="bottom", shrink=0.75, aspect=34, pad=0.03, extend="both")
        bar.set_label("measured minus wanted [mm]")
        bar.outline.set_visible(False)
    return figure
