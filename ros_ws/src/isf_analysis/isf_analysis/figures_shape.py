"""Figures of the formed shape: deviation maps, sections, errors by region. Lengths in mm, as people read them."""

from __future__ import annotations

import numpy as np
from isf_core.height_map import HeightMap
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from isf_analysis import style
from isf_analysis.deviation import OPENING_DEPTH, REGIONS, Deviation, flange_level

Array = NDArray[np.float64]

MM = 1e3
MARGIN = 25e-3
"""m of flange shown around the opening."""

REGION_LABELS = {
    "wall_and_base": "whole part",
    "wall": "wall",
    "base": "base",
    "rim": "rim (10 mm around)",
    "flange": "flange",
}


def map_limit(*deviations: Deviation | None) -> float:
    """mm, half of the colour scale that holds every given part: a round number above the largest |e| shown."""
    largest = [
        MM * max(deviation.whole.max_abs, np.nan_to_num(deviation.regions["rim"].max_abs))
        for deviation in deviations
        if deviation is not None
    ]
    return style.rounded_limit(max(largest, default=0.0))


def deviation_map(deviation: Deviation, target: HeightMap, limit: float) -> Figure:
    """Plan view of one part's deviation."""
    figure = style.new_figure(6.0, maps=True)
    axes = figure.subplots()
    image = _draw_map(axes, deviation, target, limit)
    _colour_bar(figure, image, [axes])
    return figure


def deviation_pair(
    before: Deviation, before_target: HeightMap, after: Deviation, target: HeightMap, limit: float, label: str
) -> Figure:
    """Plan views of the uncorrected and of the corrected part with the same colours."""
    figure = style.new_figure(5.0, maps=True)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    _draw_map(left, before, before_target, limit)
    image = _draw_map(right, after, target, limit)
    left.set_title("uncorrected", color=style.UNCORRECTED)
    right.set_title(label, color=style.PART)
    right.set_ylabel("")
    _colour_bar(figure, image, [left, right], horizontal=True)
    return figure


def section(angle: float, target: HeightMap, part: HeightMap, reference: HeightMap | None, extent: float) -> Figure:
    """Section through the origin at ``angle`` (rad from x) to ``extent`` (m): profiles to scale, and the error."""
    s = np.linspace(-extent, extent, 801)
    points = s[:, None] * np.array([np.cos(angle), np.sin(angle)])
    wanted = MM * target.at(points)
    formed = MM * part.at(points)
    before = None if reference is None else MM * reference.at(points)
    heights = np.concatenate([wanted, formed] + ([] if before is None else [before]))
    span = float(np.nanmax(heights) - np.nanmin(heights)) if np.isfinite(heights).any() else 1.0
    profile_height = np.clip(style.WIDTH * 0.85 * (span + 4) / (2 * MM * extent), 0.9, 6.0)
    figure = style.new_figure(profile_height + 3.3)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[profile_height, 2.1])
    top.plot(MM * s, wanted, color=style.TARGET, linestyle=(0, (4, 2)), linewidth=1.5, label="target")
    if before is not None:
        top.plot(MM * s, before, color=style.UNCORRECTED, label="uncorrected")
        bottom.plot(MM * s, before - wanted, color=style.UNCORRECTED)
    top.plot(MM * s, formed, color=style.PART, label="this part")
    bottom.plot(MM * s, formed - wanted, color=style.PART)
    bottom.axhline(0.0, color=style.TARGET, linestyle=(0, (4, 2)), linewidth=1.2)
    top.set_aspect("equal", adjustable="box")
    top.set_ylabel("z [mm]")
    style.legend_above(top, 3)
    bottom.set_ylabel("error [mm]")
    bottom.set_xlabel("distance from the centre [mm]")
    bottom.set_xlim(-MM * extent, MM * extent)
    return figure


def section_extent(deviation: Deviation) -> float:
    """m from the centre that a section should show: the farthest corner of the opening and some flange."""
    opening = deviation.masks["wall_and_base"]
    rows, columns = np.nonzero(opening)
    radius = np.hypot(deviation.error.x[columns], deviation.error.y[rows]).max()
    half = min(np.abs(deviation.error.x[[0, -1]]).min(), np.abs(deviation.error.y[[0, -1]]).min())
    return float(min(radius + MARGIN, half))


def region_errors(deviation: Deviation, reference: Deviation | None) -> Figure:
    """Largest and mean error by region, uncorrected and this part."""
    names = [name for name in REGIONS if deviation.regions[name].cells]
    figure = style.new_figure(1.5 + 0.62 * len(names))
    panels = figure.subplots(1, 2, sharey=True)
    rows = np.arange(len(names))[::-1].astype(float)
    for axes, attribute, title in zip(panels, ("max_abs", "mean_abs"), ("largest error", "mean error"), strict=True):
        parts = [(deviation, style.PART, "this part", -0.19 if reference else 0.0)]
        if reference is not None:
            parts.append((reference, style.UNCORRECTED, "uncorrected", 0.19))
        for part, colour, label, shift in reversed(parts):
            values = np.array([MM * getattr(part.regions[name], attribute) for name in names])
            axes.barh(rows + shift, values, height=0.36 if reference else 0.55, color=colour, label=label)
            for row, value in zip(rows, values, strict=True):
                text = f" {value:.2f}" if np.isfinite(value) else " not measured"
                axes.text(np.nan_to_num(value), row + shift, text, va="center", fontsize=10.5)
        axes.set_title(title)
        axes.set_xlabel("mm")
        axes.margins(x=0.16)
        axes.grid(visible=False, axis="y")
    panels[0].set_yticks(rows, [REGION_LABELS[name] for name in names])
    if reference is not None:
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def _draw_map(axes: Axes, deviation: Deviation, target: HeightMap, limit: float) -> AxesImage:
    error = deviation.error
    x, y = MM * error.x, MM * error.y
    half_x, half_y = 0.5 * (x[1] - x[0]), 0.5 * (y[1] - y[0])
    image = axes.imshow(
        MM * error.z,
        origin="lower",
        extent=(x[0] - half_x, x[-1] + half_x, y[0] - half_y, y[-1] + half_y),
        cmap=style.DEVIATION_MAP,
        vmin=-limit,
        vmax=limit,
        interpolation="nearest",
        zorder=1,
    )
    axes.set_facecolor("#e9edf0")  # unknown cells are transparent
    _draw_target(axes, target)
    _draw_opening(axes, target)
    worst_x, worst_y, worst = (MM * value for value in deviation.whole.worst)
    if np.isfinite(worst):
        axes.plot(
            worst_x, worst_y, marker="o", markersize=8, markerfacecolor="none", markeredgecolor=style.INK, zorder=4
        )
        right = worst_x > 0.5 * (x[0] + x[-1])  # the label goes towards the middle of the part
        axes.annotate(
            f"{worst:+.2f} mm".replace("-", "\N{MINUS SIGN}"),
            (worst_x, worst_y),
            xytext=(-9 if right else 9, 9),
            horizontalalignment="right" if right else "left",
            textcoords="offset points",
            fontsize=11,
            weight="bold",
            bbox={"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
            zorder=5,
        )
    _frame_opening(axes, deviation)
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    axes.grid(visible=False)
    return image


def _draw_target(axes: Axes, target: HeightMap) -> None:
    """Height lines of the target, so that the eye sees the part."""
    depth = -MM * target.z
    deepest = float(np.nanmax(depth)) if np.isfinite(depth).any() else 0.0
    if deepest <= 0:
        return
    step = style.rounded_limit(deepest / 6)
    levels = -np.arange(step, 0.98 * deepest, step)[::-1]  # a line at the depth of a flat base is noise
    if len(levels):
        axes.contour(
            MM * target.x,
            MM * target.y,
            np.ma.masked_invalid(MM * target.z),
            levels=levels,
            colors=style.MUTED,
            linewidths=0.6,
            linestyles="solid",
            zorder=2,
        )


def _draw_opening(axes: Axes, target: HeightMap) -> None:
    """The edge of the opening, found between the cells so that it looks as smooth as the part."""
    level = MM * (flange_level(target) - OPENING_DEPTH)
    axes.contour(
        MM * target.x,
        MM * target.y,
        np.ma.masked_invalid(MM * target.z),
        levels=[level],
        colors=style.INK,
        linewidths=1.5,
        linestyles="solid",
        zorder=3,
    )


def _frame_opening(axes: Axes, deviation: Deviation) -> None:
    rows, columns = np.nonzero(deviation.masks["wall_and_base"])
    x, y = deviation.error.x, deviation.error.y
    axes.set_xlim(MM * max(x[0], x[columns.min()] - MARGIN), MM * min(x[-1], x[columns.max()] + MARGIN))
    axes.set_ylim(MM * max(y[0], y[rows.min()] - MARGIN), MM * min(y[-1], y[rows.max()] + MARGIN))


def _colour_bar(figure: Figure, image: AxesImage, axes: list[Axes], *, horizontal: bool = False) -> None:
    bar = figure.colorbar(
        image,
        ax=axes,
        location="bottom" if horizontal else "right",
        shrink=0.75 if horizontal else 0.85,
        aspect=34 if horizontal else 28,
        pad=0.03,
    )
    label = "too deep   <   deviation [mm]   >   too high"
    bar.set_label(label)
    bar.outline.set_visible(False)
