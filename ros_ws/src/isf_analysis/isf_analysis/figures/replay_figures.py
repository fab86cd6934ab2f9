"""A part as it was recorded, beside what other parameters make of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from isf_core.contour import ContourCorrection, ContourResult
from isf_core.types import Array
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from isf_analysis.figures import style
from isf_analysis.measures.deviation import OPENING_DEPTH, flange_level
from isf_analysis.measures.force_metrics import force_metrics, has_set_point, rms_by_contour
from isf_analysis.measures.record import PartRecord

RECORDED, WHAT_IF = "recorded", "what if"
_STYLE = {RECORDED: "-", WHAT_IF: "--"}


def what_if(
    part: PartRecord, again: PartRecord | None, corrections: Sequence[ContourCorrection] | None, moved: Array | None
) -> Figure:
    """Panels that there is something to show in.

    ``again`` : the part formed again ; ``corrections`` : decided again from what was recorded ; ``moved`` : (C, 3),
    contour, and how far, m, forming and support tip would be from the recorded targets with the recorded forces.
    """
    panels: list[Callable[..., None]] = []
    if again is not None and force_metrics(again.results, again.control_rate) is not None:
        panels += [_draw_rms, _draw_force]
    if moved is not None and len(moved):
        panels.append(_draw_moved)
    changed = again.corrections if again is not None else corrections
    if part.corrects and changed:
        panels.append(_draw_corrections)
    if again is not None and part.scan is not None and again.scan is not None and part.target is not None:
        panels.append(_draw_section)
    figure = style.new_figure(2.6 * max(1, len(panels)) + 0.3)
    for k, draw in enumerate(panels):
        axes = figure.add_subplot(len(panels), 1, k + 1)
        draw(axes, part, again, changed, moved)
    return figure


def _contour_axis(axes: Axes) -> None:
    axes.set_xlabel("contour")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _rms(part: PartRecord) -> tuple[Array, Array]:
    known = rms_by_contour(part.results, part.control_rate)
    table = np.array([(index + 1, rms) for index, rms in known.items()], dtype=float).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _draw_rms(axes: Axes, part: PartRecord, again: PartRecord, *_: object) -> None:
    for record, colour, label in ((part, style.UNCORRECTED, RECORDED), (again, style.PART, WHAT_IF)):
        axes.plot(*_rms(record), marker=".", color=colour, linestyle=_STYLE[label], label=label)
    axes.set_title("Force error of each contour", pad=24)
    axes.set_ylabel("rms [N]")
    _contour_axis(axes)
    axes.set_ylim(bottom=0.0)
    style.legend_above(axes)


def _draw_force(axes: Axes, part: PartRecord, again: PartRecord, *_: object) -> None:
    """The contour whose force changes most."""
    before = {result.index: result for result in part.results if has_set_point(result)}
    after = {result.index: result for result in again.results if has_set_point(result)}
    both = sorted(before.keys() & after.keys())
    first, second = dict(zip(*_rms(part), strict=True)), dict(zip(*_rms(again), strict=True))
    chosen = max(both, key=lambda k: abs(first.get(k + 1, 0.0) - second.get(k + 1, 0.0)))
    for result, colour, label in (
        (before[chosen], style.UNCORRECTED, RECORDED),
        (after[chosen], style.PART, WHAT_IF),
    ):
        axes.plot(_since(result), result.tick_normal_force, color=colour, linewidth=0.8, label=label)
    wanted = after[chosen].tick_set_point
    axes.plot(_since(after[chosen]), wanted, color=style.SET_POINT, linewidth=1.0, label="set-point")
    axes.set_title(f"Normal force on contour {chosen + 1}", pad=24)
    axes.set_ylabel("force [N]")
    axes.set_xlabel("time since its begin [s]")
    style.legend_above(axes)


def _since(result: ContourResult) -> Array:
    return result.tick_time - result.tick_time[0]


def _draw_moved(axes: Axes, part: PartRecord, again: object, changed: object, moved: Array) -> None:
    axes.plot(moved[:, 0] + 1, 1e6 * moved[:, 2], ".-", color=style.PART, label="support tool")
    axes.plot(moved[:, 0] + 1, 1e6 * moved[:, 1], ".-", color=style.PREDICTION, label="forming tool")
    axes.set_title("Change of targets with the recorded forces", pad=24)
    axes.set_ylabel("largest [µm]")
    style.legend_above(axes)
    _contour_axis(axes)


def _draw_corrections(
    axes: Axes, part: PartRecord, again: PartRecord | None, changed: Sequence[ContourCorrection], *_: object
) -> None:
    for items, colour, label in ((part.corrections, style.UNCORRECTED, RECORDED), (changed, style.PART, WHAT_IF)):
        numbers = [item.index + 1 for item in items]
        sizes = [1e3 * float(np.linalg.norm(item.offset, axis=1).mean()) for item in items]
        axes.plot(numbers, sizes, marker=".", color=colour, linestyle=_STYLE[label], label=label)
    axes.set_title("Correction" if again is not None else "Correction decided from the record", pad=24)
    axes.set_ylabel("mean [mm]")
    _contour_axis(axes)
    style.legend_above(axes)


def _draw_section(axes: Axes, part: PartRecord, again: PartRecord, *_: object) -> None:
    target = part.target
    assert target is not None  # asked before
    middle = target.y[len(target.y) // 2]
    places = np.column_stack([target.x, np.full(len(target.x), middle)])
    for record, colour, label in ((part, style.UNCORRECTED, RECORDED), (again, style.PART, WHAT_IF)):
        assert record.scan is not None  # asked before
        axes.plot(
            1e3 * target.x,
            1e3 * (record.scan.at(places) - target.at(places)),
            color=colour,
            linestyle=_STYLE[label],
            label=label,
        )
    axes.axhline(0.0, color=style.TARGET, linewidth=0.8)
    formed = 1e3 * target.x[np.abs(target.at(places) - flange_level(target)) > OPENING_DEPTH]
    if len(formed):
        axes.set_xlim(1.3 * formed[0], 1.3 * formed[-1])
    axes.set_title(f"Error of the shape along y = {1e3 * middle:.0f} mm", pad=24)
    axes.set_ylabel("measured - wanted [mm]")
    axes.set_xlabel("x [mm]")
    style.legend_above(axes)
