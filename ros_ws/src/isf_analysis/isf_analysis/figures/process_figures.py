"""Figures of the process: support force, corrections and forming force, over time and contour by contour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core.contour import ContourCorrection, ContourResult, contour_label
from isf_core.types import Array
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from isf_analysis.figures import style
from isf_analysis.measures.error_split import ErrorSplit
from isf_analysis.measures.force_metrics import BAND, engaged, has_set_point
from isf_analysis.measures.record import PartRecord

MM = 1e3
SMALLEST_RANGE = 0.1  # mm, of an axis of errors
_BINS = 900  # of the time axis: one per pixel column or so


def has_support_force(record: PartRecord) -> bool:
    """True when the force on a support tool was measured."""
    return any(_measured(result) for result in record.results)


def support_force(record: PartRecord) -> Figure:
    """Measured support force: the whole part, one contour in detail, and every contour's spread."""
    results = [result for result in record.results if _measured(result)]
    if any(has_set_point(result) for result in results):
        figure = style.new_figure(9.6)
        whole, detail, spread = figure.subplots(3, 1)
        _draw_over_time(whole, results)
        controlled = [result for result in results if has_set_point(result)]
        _draw_detail(detail, controlled[len(controlled) // 2])
        _draw_error_spread(spread, controlled)
        return figure
    figure = style.new_figure(6.2)
    whole, spread = figure.subplots(2, 1)
    _draw_over_time(whole, results)
    _draw_force_spread(spread, results)
    return figure


def corrections(record: PartRecord) -> Figure:
    """How far each contour was moved down, and the springback that was predicted for it."""
    outlook = has_outlook(record)
    figure = style.new_figure(7.4 if outlook else 4.4)
    panels = figure.subplots(2 if outlook else 1, 1, squeeze=False, height_ratios=[1.4, 1] if outlook else [1])[:, 0]
    axes = panels[0]
    items = record.corrections
    number = _numbers(items)
    upwards = {contour.index for contour in record.nominal if contour.forming_tool == 2}  # formed from below
    depth = [
        (MM if item.index in upwards else -MM) * item.offset[:, 2] if len(item.offset) else np.full(1, np.nan)
        for item in items
    ]
    axes.fill_between(
        number,
        [float(values.min()) for values in depth],
        [float(values.max()) for values in depth],
        color=style.PART,
        alpha=0.22,
        linewidth=0,
        label="correction, least to most",
    )
    axes.plot(number, [float(values.mean()) for values in depth], color=style.PART, label="correction, mean")
    predicted = np.array([MM * float(item.springback.mean()) if len(item.springback) else np.nan for item in items])
    if np.isfinite(predicted).any():
        axes.plot(number, predicted, color=style.PREDICTION, linestyle=(0, (4, 2)), label="predicted springback, mean")
    doubt = np.array([MM * _rms(item.uncertainty) for item in items])
    if np.isfinite(doubt).any():
        axes.fill_between(
            number,
            predicted - doubt,
            predicted + doubt,
            color=style.PREDICTION,
            alpha=0.18,
            linewidth=0,
            label="its uncertainty, ± 1 σ",
        )
    limited = np.array([bool(item.saturated.any()) for item in items])
    if limited.any():
        axes.plot(
            number[limited],
            np.array([float(values.max()) for values in depth])[limited],
            linestyle="none",
            marker="v",
            color=style.LIMIT,
            label="a limit was reached",
        )
    sideways = np.array([MM * _sideways(item) for item in items])
    if np.nanmax(sideways, initial=0.0) > 1e-3:
        axes.plot(number, sideways, color=style.MUTED, linewidth=1.2, label="sideways, largest")
    axes.set_ylabel("moved deeper by [mm]")
    _contour_axis(axes, number)
    style.legend_above(axes, 2)
    if outlook:
        _draw_residual(panels[1], items, number)
    return figure


def has_outlook(record: PartRecord) -> bool:
    """True when a method told which error it foresees to remain."""
    return any(np.isfinite(item.residual).any() for item in record.corrections)


def _draw_residual(axes: Axes, items: Sequence[ContourCorrection], number: Array) -> None:
    left = [MM * _known(item.residual) for item in items]
    low, mean, high = ([float(f(values)) for values in left] for f in (np.min, np.mean, np.max))
    axes.fill_between(number, low, high, color=style.MUTED, alpha=0.25, linewidth=0, label="least to most")
    axes.plot(number, mean, color=style.INK, label="foreseen to remain, mean")
    doubt = np.array([MM * _rms(item.uncertainty) for item in items])
    if np.isfinite(doubt).any():
        axes.plot(number, mean + doubt, color=style.PREDICTION, linestyle=(0, (1, 2)), label="± 1 σ of the prediction")
        axes.plot(number, mean - doubt, color=style.PREDICTION, linestyle=(0, (1, 2)))
        low, high = np.fmin(low, mean - doubt).tolist(), np.fmax(high, mean + doubt).tolist()
    axes.axhline(0.0, color=style.TARGET, linestyle=(0, (4, 2)), linewidth=1.2)
    axes.set_ylim(1.05 * min(*low, -SMALLEST_RANGE), 1.05 * max(*high, SMALLEST_RANGE))  # rounding is no error
    axes.set_ylabel("too low < error > too high [mm]")
    _contour_axis(axes, number)
    style.legend_above(axes, 2)


def error_split(splits: Sequence[ErrorSplit]) -> Figure:
    """Terms of the error of the formed part, mean of every contour."""
    figure = style.new_figure(4.8)
    axes = figure.subplots()
    number = np.array([split.index + 1 for split in splits], dtype=float)
    for name, words, colour in (
        ("correction", "correction", style.PART),
        ("tool", "tool, $\\delta_1$", style.SET_POINT),
        ("sheet", "sheet, $\\delta_2$", style.PREDICTION),
        ("error", "part in the clamp: the sum", style.INK),
        ("released", "release, $\\delta_3$", style.TARGET),
    ):
        if not len(getattr(splits[0], name)):
            continue
        values = np.array([MM * float(np.mean(_known(getattr(split, name)))) for split in splits])
        if np.isfinite(values).any():
            axes.plot(number, values, color=colour, label=words, marker="." if len(number) < 30 else "")
    axes.axhline(0.0, color=style.MUTED, linestyle=(0, (4, 2)), linewidth=1.2)
    axes.set_ylabel("too far < > not far enough [mm]")
    _contour_axis(axes, number)
    style.legend_above(axes, 5)
    return figure


def forming_force(record: PartRecord) -> Figure:
    """Force of the sheet on the forming tool, contour by contour, with the forecast that corrections relied on."""
    figure = style.new_figure(4.4)
    axes = figure.subplots()
    results = [result for result in record.results if len(result.forming_force)]
    number = _numbers(results)
    axial = [_known(np.abs(result.forming_force[:, 2])) for result in results]
    low, mean, high = ([float(f(values)) for values in axial] for f in (_low, np.mean, _high))
    axes.fill_between(number, low, high, color=style.PART, alpha=0.22, linewidth=0, label="axial, 5-95 % of the points")
    axes.plot(number, mean, color=style.PART, label="axial, mean")
    horizontal = [float(_known(np.hypot(*result.forming_force[:, :2].T)).mean()) for result in results]
    axes.plot(number, horizontal, color=style.MUTED, linewidth=1.4, label="horizontal, mean")
    forecasts = [item for item in record.corrections if len(item.control_point_force)]
    if forecasts:
        values = [float(item.control_point_force.mean()) for item in forecasts]
        axes.plot(_numbers(forecasts), values, color=style.PREDICTION, linestyle=(0, (4, 2)), label="axial, forecast")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("force [N]")
    _contour_axis(axes, number)
    style.legend_above(axes, 2)
    return figure


def _draw_over_time(axes: Axes, results: Sequence[ContourResult]) -> None:
    """Least to most force per column of pixels: nothing between two drawn points is hidden."""
    time = np.concatenate([result.tick_time for result in results])
    force = np.concatenate([result.tick_normal_force for result in results])
    edges = np.linspace(time.min(), time.max(), _BINS + 1)
    controlled = [result for result in results if has_set_point(result)]
    if controlled:
        in_control = np.concatenate(
            [engaged(r) if has_set_point(r) else np.zeros(len(r.tick_time), bool) for r in results]
        )
        _fill_bins(axes, edges, time, np.where(in_control, np.nan, force), "#aeb8c2", "ramps and position control")
        _fill_bins(axes, edges, time, np.where(in_control, force, np.nan), style.PART, "measured, in full control")
    else:
        _fill_bins(axes, edges, time, force, style.PART, "measured, least to most")
    if controlled:
        _draw_set_point(axes, edges, controlled)
    axes.set_ylabel("support force [N]")
    axes.set_xlabel("time of the process [s]")
    axes.set_xlim(edges[0], edges[-1])
    style.legend_above(axes, 2)


def _draw_set_point(axes: Axes, edges: Array, controlled: Sequence[ContourResult]) -> None:
    """One band where there is one set-point; where it differs from place to place, what it was at every time."""
    values = np.concatenate([result.tick_set_point[engaged(result)] for result in controlled])
    usual = _usual_set_point(controlled)
    if not len(values) or np.ptp(values) < 1.0:
        axes.axhspan(usual - BAND, usual + BAND, color=style.SET_POINT, alpha=0.22, linewidth=0, zorder=1)
        label = f"set-point {usual:.0f} N ± {BAND:.0f} N"
        axes.axhline(usual, color=style.SET_POINT, linewidth=1.5, label=label, zorder=3)
        return
    time = np.concatenate([result.tick_time[engaged(result)] for result in controlled])
    cell = np.clip(np.digitize(time, edges) - 1, 0, _BINS - 1)
    middle = 0.5 * (edges[:-1] + edges[1:])
    low, high = _by_bin(np.fmin, cell, values), _by_bin(np.fmax, cell, values)
    axes.fill_between(middle, low - BAND, high + BAND, color=style.SET_POINT, alpha=0.22, linewidth=0, zorder=1)
    axes.plot(
        np.repeat(middle, 2),
        np.column_stack([low, high]).ravel(),
        color=style.SET_POINT,
        linewidth=0.8,
        label=f"set-point {values.min():.0f} to {values.max():.0f} N ± {BAND:.0f} N",
        zorder=3,
    )


def _draw_detail(axes: Axes, result: ContourResult) -> None:
    time = result.tick_time - result.tick_time[0]
    set_point = result.tick_set_point
    axes.fill_between(time, set_point - BAND, set_point + BAND, color=style.SET_POINT, alpha=0.22, linewidth=0)
    axes.plot(time, result.tick_normal_force, color=style.PART, linewidth=0.7, label=contour_label(result.index))
    axes.plot(time, set_point, color=style.SET_POINT, linewidth=1.5, label="its set-point ± 10 N")
    axes.set_ylabel("support force [N]")
    axes.set_xlabel("time from the start of the contour [s]")
    axes.margins(x=0)
    _zoom(axes, result)
    style.legend_above(axes, 2)


def _zoom(axes: Axes, result: ContourResult) -> None:
    """Show what happens around the set-point; the ramps from zero are in the figure above."""
    in_control = engaged(result)
    if not in_control.any():
        return
    force, set_point = result.tick_normal_force[in_control], result.tick_set_point[in_control]
    low = min(float(force.min()), float(set_point.min()) - 2 * BAND)
    high = max(float(force.max()), float(set_point.max()) + 2 * BAND)
    axes.set_ylim(low - 0.1 * BAND, high + 0.1 * BAND)


def _draw_error_spread(axes: Axes, results: Sequence[ContourResult]) -> None:
    error = [_known((r.tick_normal_force - r.tick_set_point)[engaged(r)]) for r in results]
    axes.axhspan(-BAND, BAND, color=style.SET_POINT, alpha=0.22, linewidth=0, label=f"± {BAND:.0f} N")
    _draw_spread(axes, _numbers(results), error)
    axes.set_ylabel("force error [N]")


def _draw_force_spread(axes: Axes, results: Sequence[ContourResult]) -> None:
    _draw_spread(axes, _numbers(results), [_known(result.tick_normal_force) for result in results])
    axes.set_ylabel("support force [N]")


def _draw_spread(axes: Axes, number: Array, values: Sequence[Array]) -> None:
    quantiles = np.array([np.quantile(item, [0.001, 0.01, 0.5, 0.99, 0.999]) for item in values])
    axes.vlines(number, quantiles[:, 0], quantiles[:, 4], color=style.PART, linewidth=1.0, label="99.8 % of the time")
    axes.vlines(number, quantiles[:, 1], quantiles[:, 3], color=style.PART, linewidth=3.2, label="98 % of the time")
    axes.plot(number, quantiles[:, 2], linestyle="none", marker="o", markersize=3.6, color=style.INK, label="median")
    _contour_axis(axes, number)
    style.legend_above(axes, 4)


def _usual_set_point(controlled: Sequence[ContourResult]) -> float:
    """N, median over the ticks in full control; the largest of the ramps when the loop never got that far."""
    values = np.concatenate([result.tick_set_point[engaged(result)] for result in controlled])
    if len(values):
        return float(np.median(values))
    return max(float(np.nanmax(result.tick_set_point, initial=0.0)) for result in controlled)


def _fill_bins(axes: Axes, edges: Array, time: Array, force: Array, colour: str, label: str) -> None:
    cell = np.clip(np.digitize(time, edges) - 1, 0, _BINS - 1)
    middle = 0.5 * (edges[:-1] + edges[1:])
    low, high = _by_bin(np.fmin, cell, force), _by_bin(np.fmax, cell, force)
    axes.fill_between(middle, low, high, color=colour, linewidth=0.6, label=label, zorder=2)


def _by_bin(function: np.ufunc, cell: NDArray[np.intp], values: Array) -> Array:
    found = np.full(_BINS, np.nan)
    function.at(found, cell, values)
    return found


def _contour_axis(axes: Axes, number: Array) -> None:
    axes.set_xlabel("contour")
    if len(number):
        axes.set_xlim(number.min() - 0.8, number.max() + 0.8)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _numbers(items: Sequence[ContourResult] | Sequence[ContourCorrection]) -> Array:
    """Contours as a person counts them, from 1."""
    return np.array([item.index + 1 for item in items], dtype=float)


def _measured(result: ContourResult) -> bool:
    """A part without a support tool has the noise of an idle load cell in its ticks."""
    supported = len(result.support_force) > 0
    return supported and len(result.tick_normal_force) > 0 and bool(np.isfinite(result.tick_normal_force).any())


def _sideways(item: ContourCorrection) -> float:
    return float(np.hypot(*item.offset[:, :2].T).max()) if len(item.offset) else 0.0


def _rms(values: Array) -> float:
    """Root mean square of what is known; NaN when nothing is."""
    return float(np.sqrt(np.mean(_known(values) ** 2)))


def _known(values: Array) -> Array:
    """Finite values; a single NaN when there is none, so that statistics stay NaN without a warning."""
    finite = values[np.isfinite(values)]
    return finite if len(finite) else np.full(1, np.nan)


def _low(values: Array) -> float:
    return float(np.quantile(values, 0.05))


def _high(values: Array) -> float:
    return float(np.quantile(values, 0.95))
