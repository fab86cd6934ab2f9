"""A part as it was recorded, beside what other parameters make of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class _Shown:
    """What the panels draw; ``changed``: corrections, ``moved``, ``name``, ``start``: as of :func:`what_if`."""

    part: PartRecord
    again: PartRecord | None
    changed: Sequence[ContourCorrection]
    moved: Array | None
    name: str
    start: int | None

    def both(self) -> tuple[tuple[PartRecord, str, str, str], ...]:
        """Record, colour, line and label of the recorded part and of the one that was formed again."""
        assert self.again is not None  # asked before
        return (
            (self.part, style.UNCORRECTED, "-", RECORDED),
            (self.again, style.PART, "--", self.name),
        )


def what_if(
    part: PartRecord,
    again: PartRecord | None,
    corrections: Sequence[ContourCorrection] | None,
    moved: Array | None,
    name: str = WHAT_IF,
    start: int | None = None,
) -> Figure:
    """Panels that there is something to show in.

    ``again`` : the part formed again ; ``corrections`` : decided again from what was recorded ; ``moved`` : (C, 3),
    contour, and how far, m, forming and support tip would be from the recorded targets with the recorded forces.
    ``name`` : of what is shown beside the record ; ``start`` : contour, from 0, that is marked as the first that may
    differ from it.
    """
    panels: list[Callable[[Axes, _Shown], None]] = []
    if again is not None and _compared_forces(part, again):
        panels += [_draw_rms, _draw_force]
    if moved is not None and len(moved):
        panels.append(_draw_moved)
    changed = (again.corrections if again is not None else corrections) or ()
    if changed and (part.corrects or any(item.offset.any() for item in changed)):
        panels.append(_draw_corrections)
    if again is not None and part.scan is not None and again.scan is not None and part.target is not None:
        panels.append(_draw_section)
    shown = _Shown(part, again, changed, moved, name, start)
    figure = style.new_figure(2.6 * max(1, len(panels)) + 0.3)
    for k, draw in enumerate(panels):
        axes = figure.add_subplot(len(panels), 1, k + 1)
        draw(axes, shown)
    return figure


def _compared_forces(part: PartRecord, again: PartRecord) -> bool:
    """True when both held a force, on a contour that both have."""
    held = [{result.index for result in record.results if has_set_point(result)} for record in (part, again)]
    known = (force_metrics(record.results, record.control_rate) is not None for record in (part, again))
    return bool(held[0] & held[1]) and all(known)


def _contour_axis(axes: Axes, shown: _Shown) -> None:
    axes.set_xlabel("contour")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if shown.start is not None:  # between the last contour as it was and the first with the changes
        axes.axvline(shown.start + 0.5, color=style.LIMIT, linewidth=1.0, label=f"from contour {shown.start + 1} on")


def _rms(part: PartRecord) -> tuple[Array, Array]:
    known = rms_by_contour(part.results, part.control_rate)
    table = np.array([(index + 1, rms) for index, rms in known.items()], dtype=float).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _draw_rms(axes: Axes, shown: _Shown) -> None:
    for record, colour, line, label in shown.both():
        axes.plot(*_rms(record), marker=".", color=colour, linestyle=line, label=label)
    axes.set_title("Force error of each contour", pad=24)
    axes.set_ylabel("rms [N]")
    _contour_axis(axes, shown)
    axes.set_ylim(bottom=0.0)
    style.legend_above(axes)


def _draw_force(axes: Axes, shown: _Shown) -> None:
    """The contour whose force changes most."""
    before, after = (
        {result.index: result for result in record.results if has_set_point(result)} for record, *_ in shown.both()
    )
    both = sorted(before.keys() & after.keys())
    first, second = (dict(zip(*_rms(record), strict=True)) for record, *_ in shown.both())
    chosen = max(both, key=lambda k: abs(first.get(k + 1, 0.0) - second.get(k + 1, 0.0)))
    for results, (_, colour, _, label) in zip((before, after), shown.both(), strict=True):
        result = results[chosen]
        axes.plot(_since(result), result.tick_normal_force, color=colour, linewidth=0.8, label=label)
    wanted = after[chosen].tick_set_point
    axes.plot(_since(after[chosen]), wanted, color=style.SET_POINT, linewidth=1.0, label="set-point")
    axes.set_title(f"Normal force on contour {chosen + 1}", pad=24)
    axes.set_ylabel("force [N]")
    axes.set_xlabel("time since its begin [s]")
    style.legend_above(axes)


def _since(result: ContourResult) -> Array:
    return result.tick_time - result.tick_time[0]


def _draw_moved(axes: Axes, shown: _Shown) -> None:
    moved = shown.moved
    assert moved is not None  # asked before
    axes.plot(moved[:, 0] + 1, 1e6 * moved[:, 2], ".-", color=style.PART, label="support tool")
    axes.plot(moved[:, 0] + 1, 1e6 * moved[:, 1], ".-", color=style.PREDICTION, label="forming tool")
    axes.set_title("Change of targets with the recorded forces", pad=24)
    axes.set_ylabel("largest [µm]")
    style.legend_above(axes)
    _contour_axis(axes, shown)


def _draw_corrections(axes: Axes, shown: _Shown) -> None:
    for items, colour, line, label in (
        (shown.part.corrections, style.UNCORRECTED, "-", RECORDED),
        (shown.changed, style.PART, "--", shown.name),
    ):
        numbers = [item.index + 1 for item in items]
        sizes = [1e3 * float(np.linalg.norm(item.offset, axis=1).mean()) for item in items]
        axes.plot(numbers, sizes, marker=".", color=colour, linestyle=line, label=label)
    axes.set_title("Correction" if shown.again is not None else "Correction decided from the record", pad=24)
    axes.set_ylabel("mean [mm]")
    _contour_axis(axes, shown)
    style.legend_above(axes)


def _draw_section(axes: Axes, shown: _Shown) -> None:
    target = shown.part.target
    assert target is not None  # asked before
    middle = target.y[len(target.y) // 2]
    places = np.column_stack([target.x, np.full(len(target.x), middle)])
    for record, colour, line, label in shown.both():
        assert record.scan is not None  # asked before
        axes.plot(
            1e3 * target.x,
            1e3 * (record.scan.at(places) - target.at(places)),
            color=colour,
            linestyle=line,
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
