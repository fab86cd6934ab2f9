"""Figure of the contact of the support tool along the contours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core.types import Array
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from isf_analysis.figures import style
from isf_analysis.measures.force_metrics import BAND
from isf_analysis.measures.force_regions import PathForce

MM = 1e3
_COLUMNS = 400
"""Of the unrolled picture: about two pixels each."""
_MAXIMUM_DRAWN = 60_000
"""Points in the plan view; more are thinned evenly, those without contact never."""
_ERROR_COLOURS, _FORCE_COLOURS = "PuOr", "viridis"


def contact_map(paths: Sequence[PathForce]) -> Figure:
    """Where contact was lost, in the plan and along every contour, the latter with the force or its error."""
    figure = style.new_figure(9.0)
    plan, unrolled = figure.subplots(2, 1, height_ratios=[1.35, 1.0])
    _draw_plan(plan, paths)
    _draw_unrolled(figure, unrolled, paths)
    return figure


def _draw_plan(axes: Axes, paths: Sequence[PathForce]) -> None:
    tip = np.concatenate([path.tip[:, :2] for path in paths])
    lost = np.concatenate([path.lost for path in paths])
    step = max(1, len(tip) // _MAXIMUM_DRAWN)
    held = tip[~lost][::step]
    axes.plot(*(MM * held.T), ".", markersize=1.6, color="#9aa5b1", zorder=1, label="_held")
    axes.plot([], [], color="#9aa5b1", label="in contact")
    axes.plot(
        *(MM * tip[lost].T),
        linestyle="none",
        marker=".",
        markersize=4.5,
        color=style.UNCORRECTED,
        zorder=2,
        label=f"contact lost ({lost.mean():.2%} of the points)".replace("%", " %"),
    )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    style.legend_above(axes, 2)


def _draw_unrolled(figure: Figure, axes: Axes, paths: Sequence[PathForce]) -> None:
    """One row per contour; a cell shows its worst point, so that nothing is hidden."""
    controlled = any(np.isfinite(path.set_point) for path in paths)
    first, last = paths[0].index, max(path.index for path in paths)
    values = np.full((last - first + 1, _COLUMNS), np.nan)
    lost = np.zeros(values.shape, dtype=bool)
    for path in paths:
        column = np.minimum((path.along * _COLUMNS).astype(int), _COLUMNS - 1)
        row = path.index - first
        values[row] = _worst(column, path.error if controlled else path.force, farthest=controlled)
        lost[row] = _worst(column, path.lost.astype(float), farthest=True) > 0.5
    limit = _limit(values, controlled=controlled)
    norm = Normalize(-limit if controlled else 0.0, limit)
    mapping = ScalarMappable(norm, _ERROR_COLOURS if controlled else _FORCE_COLOURS)
    picture = np.asarray(mapping.to_rgba(values))
    picture[~np.isfinite(values)] = (1.0, 1.0, 1.0, 0.0)
    picture[lost] = (0.0, 0.0, 0.0, 1.0)
    axes.imshow(
        picture, aspect="auto", origin="lower", extent=(0.0, 1.0, first + 0.5, last + 1.5), interpolation="nearest"
    )
    axes.set_facecolor("#e9edf0")
    axes.grid(visible=False)
    axes.set_xlabel("share of the contour's path")
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_ylabel("contour")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    label = "force less set-point [N]" if controlled else "support force [N]"
    figure.colorbar(mapping, ax=axes, label=label, extend="both" if controlled else "max", shrink=0.95)


def _worst(column: NDArray[np.intp], values: Array, *, farthest: bool) -> Array:
    """(_COLUMNS,) value farthest from zero, or the lowest; cells between the points take the nearest before them."""
    found = np.full(_COLUMNS, np.nan)
    order = np.argsort(np.abs(values) if farthest else -values, kind="stable")
    found[column[order]] = values[order]
    known = np.isfinite(found)
    if not known.any():
        return found
    latest = np.maximum.accumulate(np.where(known, np.arange(_COLUMNS), -1))
    return np.where(latest >= 0, found[latest], np.nan)


def _limit(values: Array, *, controlled: bool) -> float:
    """N, end of the colours: the band for a good part, what 99 % of the cells stay below for others."""
    known = np.abs(values[np.isfinite(values)])
    usual = float(np.quantile(known, 0.99)) if len(known) else 1.0
    return style.rounded_limit(max(usual, BAND if controlled else 1.0))
