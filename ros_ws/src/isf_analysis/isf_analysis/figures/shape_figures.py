"""Figures of the formed shape: deviation maps, sections, errors by region. Lengths in mm, as people read them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core.events import Event, EventKind, kind_name
from isf_core.geometry.height_map import HeightMap
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from isf_analysis.figures import style
from isf_analysis.figures.cuts import Cut, part_frame
from isf_analysis.figures.error_map import draw_errors, draw_opening
from isf_analysis.measures.deviation import BANDS, REGIONS, Deviation, directions, flange_level

MM = 1e3
FLAT = 2.0
"""mm: a profile that goes up and down less is shown as high as twice this, so that its axis says something."""

REGION_LABELS = {
    "wall_and_base": "whole part",
    "wall": "wall",
    "base": "base",
    "rim": "rim (10 mm around)",
    "flange": "flange",
}


_EVENT_MARKS = {
    int(EventKind.FRACTURE): ("X", "black"),
    int(EventKind.BUCKLING): ("D", style.UNCORRECTED),
    int(EventKind.SATURATION): ("s", style.LIMIT),
    int(EventKind.GALLING): ("^", "#F0E442"),
    int(EventKind.CONTACT_LOST): ("v", style.SET_POINT),
    int(EventKind.DIE_CONTACT): (".", "white"),
}
"""Shape and fill of an event's mark."""


def map_limit(*deviations: Deviation | None) -> float:
    """mm, half of the colour scale that holds every given part: a round number above the largest |e| shown."""
    largest = [
        MM * max(np.nan_to_num(deviation.regions[name].max_abs) for name in ("wall_and_base", "rim"))
        for deviation in deviations
        if deviation is not None
    ]
    return style.rounded_limit(max(largest, default=0.0))


def deviation_map(
    deviation: Deviation, target: HeightMap, limit: float, events: Sequence[Event] = (), cuts: Sequence[Cut] = ()
) -> Figure:
    """Plan view of one part's deviation, with marks where ``events`` happened, which have a place, and ``cuts``."""
    x0, x1, y0, y1 = part_frame(deviation)
    wide = y1 - y0 < 0.75 * (x1 - x0)
    figure = style.new_figure(float(np.clip(1.4 + 6.2 * (y1 - y0) / (x1 - x0), 3.4, 6.0)) if wide else 6.0, maps=True)
    axes = figure.subplots()
    image = _draw_map(axes, deviation, target, limit)
    _colour_bar(figure, image, [axes], horizontal=wide, standing=directions(target)[1])
    for cut in cuts:
        _draw_cut(axes, cut)
    if events:
        _draw_events(axes, events)
        style.legend_below(figure, axes, 3)
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
    _colour_bar(figure, image, [left, right], horizontal=True, standing=directions(target)[1])
    return figure


def section(cut: Cut, target: HeightMap, part: HeightMap, reference: HeightMap | None) -> Figure:
    """Profiles along ``cut`` to scale, and the error below them."""
    s = cut.distances()
    points = cut.points(s)
    wanted = MM * target.at(points)
    formed = MM * part.at(points)
    before = None if reference is None else MM * reference.at(points)
    heights = np.concatenate([wanted, formed] + ([] if before is None else [before]))
    span = float(np.nanmax(heights) - np.nanmin(heights)) if np.isfinite(heights).any() else 1.0
    profile_height = np.clip(style.WIDTH * 0.85 * (span + 4) / (MM * (cut.end - cut.begin)), 0.9, 6.0)
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
    if span < FLAT and np.isfinite(heights).any():
        middle = 0.5 * float(np.nanmax(heights) + np.nanmin(heights))
        top.set_ylim(middle - FLAT, middle + FLAT)
    top.set_ylabel("z [mm]")
    top.yaxis.set_major_locator(MaxNLocator(max(1, int(2.5 * profile_height))))
    style.legend_above(top, 3)
    bottom.set_ylabel("error [mm]")
    bottom.set_xlabel(f"{cut.axis} [mm]")
    bottom.set_xlim(MM * cut.begin, MM * cut.end)
    return figure


def histogram(deviation: Deviation, reference: Deviation | None, tolerance: float) -> Figure:
    """Share of the points of the whole part by their vertical error; ``tolerance`` m is marked."""
    figure = style.new_figure(3.6)
    axes = figure.subplots()
    parts = [(deviation, style.PART, "this part")]
    if reference is not None:
        parts.append((reference, style.UNCORRECTED, "uncorrected"))
    limit = style.rounded_limit(MM * max(float(np.abs(part.errors()).max(initial=tolerance)) for part, _, _ in parts))
    edges = np.linspace(-limit, limit, 121)
    for part, colour, label in parts:
        error = MM * part.errors()
        if not len(error):
            continue
        count, _ = np.histogram(error, edges)
        axes.stairs(100.0 * count / len(error), edges, color=colour, fill=part is deviation, alpha=0.8, label=label)
    for band in (*BANDS, tolerance):
        for side in (-band, band):
            line = "--" if band == tolerance else ":"
            axes.axvline(MM * side, color=style.SET_POINT, linewidth=1.6 if band == tolerance else 1.0, linestyle=line)
    axes.set_xlim(-limit, limit)
    axes.set_xlabel("vertical error [mm]")
    axes.set_ylabel("points [%]")
    style.legend_above(axes, 2)
    return figure


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
        style.legend_below(figure, panels[0], 2)
    return figure


def _draw_map(axes: Axes, deviation: Deviation, target: HeightMap, limit: float) -> AxesImage:
    image = draw_errors(axes, deviation.error, limit)
    _draw_target(axes, target)
    draw_opening(axes, target)
    worst_x, worst_y, worst = (MM * value for value in deviation.whole.worst)
    if np.isfinite(worst):
        axes.plot(
            worst_x, worst_y, marker="o", markersize=8, markerfacecolor="none", markeredgecolor=style.INK, zorder=4
        )
        right = worst_x > 0.5 * MM * (target.x[0] + target.x[-1])  # the label goes towards the middle of the part
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
    height = MM * (target.z - flange_level(target))
    known = height[np.isfinite(height)]
    span = float(known.max() - known.min()) if len(known) else 0.0
    if span <= 0:
        return
    step = style.rounded_limit(span / 6)
    # a line at the height of a flat base is noise
    below = -np.arange(step, max(0.0, -0.98 * float(known.min())), step)
    above = np.arange(step, max(0.0, 0.98 * float(known.max())), step)
    levels = MM * flange_level(target) + np.concatenate([below[::-1], above])
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


def _frame_opening(axes: Axes, deviation: Deviation) -> None:
    x0, x1, y0, y1 = part_frame(deviation)
    axes.set_xlim(MM * x0, MM * x1)
    axes.set_ylim(MM * y0, MM * y1)


def _draw_cut(axes: Axes, cut: Cut) -> None:
    """A line where a section goes, with its name along it."""
    ends = MM * cut.points(np.array([cut.begin, cut.end]))
    axes.plot(*ends.T, color=style.INK, linewidth=1.0, linestyle=(0, (6, 3)), zorder=5)
    first, last = sorted(ends.round(6).tolist())  # the words along the line, never upside down
    along = np.subtract(last, first) / np.hypot(*np.subtract(last, first))
    axes.annotate(
        cut.label,
        first,
        xytext=(6 * along[0] - 3 * along[1], 6 * along[1] + 3 * along[0]),
        textcoords="offset points",
        rotation=float(np.degrees(np.arctan2(along[1], along[0]))),
        rotation_mode="anchor",
        va="bottom",
        ha="left",
        fontsize=10,
        zorder=6,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )


def _draw_events(axes: Axes, events: Sequence[Event]) -> None:
    """A mark where each event happened, the kinds with shapes and fills of their own."""
    for kind in dict.fromkeys(event.kind for event in events):
        same = [event for event in events if event.kind == kind]
        marker, fill = _EVENT_MARKS.get(kind, ("P", "white"))
        axes.plot(
            [MM * event.position[0] for event in same],
            [MM * event.position[1] for event in same],
            linestyle="none",
            marker=marker,
            markersize=9,
            markerfacecolor=fill,
            markeredgecolor=style.INK,
            markeredgewidth=0.9,
            label=f"{kind_name(kind)} ({len(same)})",
            zorder=6,
        )


def _colour_bar(
    figure: Figure, image: AxesImage, axes: list[Axes], *, horizontal: bool = False, standing: bool = False
) -> None:
    bar = figure.colorbar(
        image,
        ax=axes,
        location="bottom" if horizontal else "right",
        shrink=0.75 if horizontal else 0.85,
        aspect=34 if horizontal else 28,
        pad=0.03,
    )
    label = f"too {'low' if standing else 'deep'}   <   deviation [mm]   >   too high"
    bar.set_label(label)
    bar.outline.set_visible(False)
