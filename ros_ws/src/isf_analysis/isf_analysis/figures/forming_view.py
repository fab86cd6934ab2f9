"""The forming step by step in the view of the part: the sheet, the path of the step, and the tips of the tools."""

from __future__ import annotations

from typing import Any

import numpy as np
from isf_core.types import Array
from isf_core.view import page
from isf_core.view.coloured import colour_bar

from isf_analysis.figures import style
from isf_analysis.measures.forming_steps import FormingStep, FormingSteps

MM = 1e3
MOST_POINTS = 240
"""Of the path of a step; of a longer one every n-th."""
DEPTHS = [[0.0, "#1b4f72"], [0.5, "#5b9bc4"], [1.0, "#dfe6ec"]]
"""Of the sheet, from the deepest place to the highest."""
OPACITY = 0.8
"""Of the sheet, so that the tool on its other side is seen."""
UPPER, LOWER = style.UNCORRECTED, style.SET_POINT
BALL = 19, 29
"""Rows and columns of a drawn ball."""


def add_forming(figure: Any, steps: FormingSteps) -> page.Steps:
    """Add the traces of ``steps`` to ``figure``, as they are at the first step."""
    sheets = MM * np.nan_to_num(np.stack([steps.before, *(step.sheet for step in steps.steps)]))
    first = len(figure.data)
    low, high = float(sheets.min()), float(sheets.max())
    figure.add_surface(
        x=np.round(MM * steps.x, 2).astype(np.float32),
        y=np.round(MM * steps.y, 2).astype(np.float32),
        z=np.round(sheets[1], 2).astype(np.float32),
        cmin=low,
        cmax=max(high, low + 0.1),
        colorscale=DEPTHS,
        opacity=OPACITY,
        colorbar=colour_bar("height [mm]"),
        hovertemplate="x %{x:.1f}, y %{y:.1f}, z %{z:.2f} mm<extra></extra>",
        lighting={"ambient": 0.7, "diffuse": 0.5, "specular": 0.05},
    )
    paths, balls = [], []
    for words, colour, tips, radius, above in (
        ("upper tool", UPPER, [step.upper for step in steps.steps], steps.radii[0], True),
        ("lower tool", LOWER, [step.lower for step in steps.steps], steps.radii[1], False),
    ):
        if not any(len(one) for one in tips):
            continue
        drawn = [MM * _thinned(one) for one in tips]
        _line(figure, words, colour, drawn[0])
        paths.append((len(figure.data) - 1, drawn))
        if radius > 0.0:
            shape = MM * ball(radius, above)
            _ball(figure, words, colour, shape + (drawn[0][-1] if len(drawn[0]) else np.nan))
            balls.append(page.Ball(len(figure.data) - 1, len(paths) - 1, shape))
    labels = [_words(step, steps) for step in steps.steps]
    return page.Steps(labels, first, sheets, paths, balls)


def ball(radius: float, above: bool) -> Array:
    """(ny, nx, 3) m, ball of ``radius`` m that touches the origin from above, or from below."""
    turn, rise = np.linspace(0.0, 2.0 * np.pi, BALL[1]), np.linspace(-0.5 * np.pi, 0.5 * np.pi, BALL[0])
    level = np.sin(rise)[:, None] * np.ones(len(turn)) + (1.0 if above else -1.0)
    return radius * np.stack([np.cos(rise)[:, None] * np.cos(turn), np.cos(rise)[:, None] * np.sin(turn), level], -1)


def _words(step: FormingStep, steps: FormingSteps) -> str:
    if not len(step.upper) and not len(step.lower):
        return f"finished part: {step.source}"
    if steps.over_die:
        where = f"blank holder {abs(MM * step.level):.1f} mm down"
    else:
        where = f"planned {abs(MM * step.level):.1f} mm {'deep' if step.level < 0.0 else 'high'}"
    return f"contour {step.index + 1} of {steps.contours}, {where}: {step.source}"


def _thinned(tips: Array) -> Array:
    """(P, 3), at most MOST_POINTS and the last one."""
    chosen = tips[:: max(1, -(-len(tips) // MOST_POINTS))]
    return np.vstack([chosen, tips[-1:]])


def _line(figure: Any, words: str, colour: str, line: Array) -> None:
    figure.add_scatter3d(
        **dict(zip("xyz", np.round(line, 2).T.astype(np.float32), strict=True)),
        mode="lines",
        line={"color": colour, "width": 5},
        name=f"path of the {words}",
        hoverinfo="skip",
        showlegend=True,
    )


def _ball(figure: Any, words: str, colour: str, places: Array) -> None:
    x, y, z = np.moveaxis(np.round(places, 2).astype(np.float32), -1, 0)
    figure.add_surface(
        x=x,
        y=y,
        z=z,
        surfacecolor=np.zeros(z.shape, dtype=np.uint8),
        colorscale=[[0.0, colour], [1.0, colour]],
        showscale=False,
        name=words,
        hovertemplate=f"{words}<extra></extra>",
        lighting={"ambient": 0.6, "diffuse": 0.6, "specular": 0.3},
    )
