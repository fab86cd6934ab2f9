"""Errors of a campaign: a strip of points for every method, a row of axes for every job."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from isf_analysis.figures import style
from isf_analysis.measures.campaign_row import CampaignRow

SPREAD = 0.28
"""Share of the distance of two strips over which the variants of one are spread, to either side."""

LONGEST_NAME = 26
"""Letters of a method beside its strip."""


def error_strips(groups: Sequence[tuple[str, Sequence[tuple[str, Sequence[CampaignRow]]]]]) -> bytes:
    """PNG of the largest errors of wall and base of whole parts.

    ``groups`` : per panel its title and the strips, name and rows of each. One scale for all panels.
    """
    with style.applied():
        strips = sum(len(group) for _, group in groups)
        figure = style.new_figure(0.7 + 0.55 * len(groups) + 0.42 * strips)
        heights = [len(group) + 0.6 for _, group in groups]
        panels = figure.subplots(len(groups), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        for axes, (title, group) in zip(panels, groups, strict=True):
            axes.set_title(title)
            for place, (_, rows) in enumerate(group):
                _strip(axes, place, [row for row in rows if row.whole])
            axes.set_yticks(range(len(group)), [_short(name) for name, _ in group])
            axes.set_ylim(len(group) - 0.5, -0.5)
            axes.grid(visible=False, axis="y")
            tolerances = {row.tolerance_mm for _, rows in group for row in rows}
            if len(tolerances) == 1 and None not in tolerances:
                axes.axvline(tolerances.pop(), color=style.SET_POINT, linestyle=":", linewidth=1.4, label="tolerance")
        panels[-1].set_xlabel("largest error of wall and base [mm]")
        panels[-1].set_xlim(left=0.0)
        return style.png(figure)


def _strip(axes: Axes, place: int, rows: Sequence[CampaignRow]) -> None:
    if not rows:
        axes.annotate(
            "no whole part", (0.01, place), xycoords=("axes fraction", "data"), color=style.MUTED, va="center"
        )
        return
    others = [row for row in rows if row.variant != 0]
    spread = SPREAD * np.linspace(-1.0, 1.0, len(others)) if len(others) > 1 else np.zeros(len(others))
    errors = np.array([row.max_mm for row in others], dtype=float)
    axes.plot(errors, place + spread, "o", color=style.PART, markersize=4.5, alpha=0.75, markeredgewidth=0)
    if len(others) > 1:
        axes.plot([np.median(errors)] * 2, [place - 0.38, place + 0.38], color=style.INK, linewidth=2.0)
    for row in rows:
        if row.variant == 0:
            axes.plot([row.max_mm], [place], "D", markersize=6, color="white", markeredgecolor=style.UNCORRECTED)


def _short(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"
