"""Pictures of ``isf springback``: control points of a part, shapes formed with several methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from isf_analysis.figures import style
from isf_analysis.measures.deviation import Deviation
from isf_analysis.measures.record import PartRecord
from isf_core.contour import Contour, contour_label
from isf_core.files.job import JobFile
from isf_springback.database.control_points import ControlLoop
from isf_springback.database.feature_clusters import k_means, k_medoids
from isf_springback.database.loop_features import loop_features
from matplotlib.axes import Axes
from numpy.typing import NDArray

MM = 1e3

_STRETCH = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#8A7F00", "#66727f")


def draw_control_points(
    contours: Sequence[Contour], loops: Sequence[ControlLoop], job_file: JobFile, path: Path
) -> Path:
    """Plan views: all control loops with their stretches and points; the middle loop by k-means and k-medoids."""
    by_index = {contour.index: contour for contour in contours}
    middle = max(loops, key=lambda loop: (len(loop.points), -loop.index))
    with style.applied():
        figure = style.new_figure(5.2, maps=True)
        left, *others = figure.subplots(1, 3, sharex=True, sharey=True)
        for loop in loops:
            _draw_stretches(left, by_index[loop.index].contact, loop.labels, width=1.2)
        for loop in loops:
            _draw_points(left, loop)
        tool = job_file.job.tool_1.radius
        contour = by_index[middle.index]
        features = loop_features(contour, tool).normalised(tool)
        clusters = int(middle.labels.max()) + 1
        for axes, name, method in zip(others, ("k-means", "k-medoids"), (k_means, k_medoids), strict=True):
            labels = method(features, clusters) if clusters > 1 else middle.labels
            _draw_stretches(axes, contour.contact, labels, width=4.0)
            axes.set_title(f"{name}, {contour_label(middle.index)}")
        left.set_title("neighbours only: control points")
        left.set_ylabel("y [mm]")
        for axes in (left, *others):
            axes.set_aspect("equal")
            axes.set_xlabel("x [mm]")
        path.write_bytes(style.png(figure))
    return path


def _draw_points(axes: Axes, loop: ControlLoop) -> None:
    """Middles as discs, boundaries as crosses; filled where computed, open where a mirror image is used."""
    computed = np.isin(np.arange(len(loop.points)), loop.computed)
    points = MM * loop.points
    for own, face in ((True, style.INK), (False, "white")):
        middle = loop.central & (computed == own)
        axes.scatter(*points[middle, :2].T, s=16, facecolors=face, edgecolors=style.INK, linewidths=0.7, zorder=3)
        edge = ~loop.central & (computed == own)
        colour = style.INK if own else style.MUTED
        axes.scatter(*points[edge, :2].T, s=22, marker="x", color=colour, linewidths=0.8, zorder=3)


def _draw_stretches(axes: Axes, contact: NDArray[np.float64], labels: NDArray[np.int64], width: float) -> None:
    """A loop with a colour per cluster; places that are no neighbours show as breaks of the colour."""
    closed = MM * np.vstack([contact[:, :2], contact[:1, :2]])
    for k in range(len(contact)):
        axes.plot(*closed[k : k + 2].T, color=_STRETCH[int(labels[k]) % len(_STRETCH)], linewidth=width)


def draw_comparison(records: Mapping[str, PartRecord], deviations: Mapping[str, Deviation | None], path: Path) -> Path:
    """Section along x of the target and of the part of every method, and its error below."""
    with style.applied():
        figure = style.new_figure(6.0)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.3))
        drawn = False
        for number, (name, record) in enumerate(records.items()):
            if deviations[name] is None or record.scan is None or record.target is None:
                continue
            x = record.target.x
            line = np.column_stack([x, np.zeros_like(x)])
            wanted = record.target.at(line)
            if not drawn:
                upper.plot(MM * x, MM * wanted, color=style.TARGET, linewidth=2.4, label="target")
                drawn = True
            measured = record.scan.at(line)
            colour = _STRETCH[number % len(_STRETCH)]
            upper.plot(MM * x, MM * measured, color=colour, label=name)
            lower.plot(MM * x, MM * (measured - wanted), color=colour)
        lower.axhline(0.0, color=style.TARGET, linewidth=1.0)
        upper.set_ylabel("z [mm]")
        lower.set_ylabel("formed minus target [mm]")
        lower.set_xlabel("x [mm]")
        style.legend_above(upper)
        path.write_bytes(style.png(figure))
    return path
