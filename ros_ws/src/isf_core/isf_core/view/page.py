"""A picture in three dimensions inside an HTML page that needs nothing else, drawn by plotly in the reader's browser.

The library and the figure are packed (gzip) into the page and unpacked when the picture comes into sight: 2.0 MB
instead of 4.8 MB. It is turned by mouse, touch and keys, zoomed by wheel, pinch and keys, and follows the reader's
light or dark scheme.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

FLATTEST = 0.02
"""Least height of the box around a figure over its largest side; all else is to scale."""

STYLE = """
.view3d { position: relative; }
.view3d-plot { height: min(68vh, 560px); min-height: 340px; }
.view3d-plot:focus-visible { outline: 2px solid #0072b2; outline-offset: 2px; }
.view3d-choice { border: 0; margin: 0 0 6px; padding: 0; display: flex; flex-wrap: wrap; gap: 6px 16px; }
.view3d-choice legend { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
.view3d-choice label { cursor: pointer; padding: 4px 0; }
.view3d-zoom { position: absolute; right: 4px; bottom: 4px; display: flex; gap: 4px; }
.view3d-zoom button { width: 36px; height: 36px; font: inherit; border: 1px solid #8895a1; border-radius: 6px;
  background: transparent; color: inherit; cursor: pointer; }
.view3d-steps { display: flex; flex-wrap: wrap; gap: 6px 12px; align-items: center; margin: 0 0 6px; }
.view3d-steps[hidden] { display: none; }
.view3d-steps button { min-width: 76px; height: 36px; font: inherit; border: 1px solid #8895a1; border-radius: 6px;
  background: transparent; color: inherit; cursor: pointer; }
.view3d-steps input { flex: 1 1 180px; min-width: 120px; height: 36px; accent-color: #0072b2; }
.view3d-steps output { flex: 1 1 100%; font-variant-numeric: tabular-nums; min-height: 1.4em; }
.view3d-steps :focus-visible { outline: 2px solid #0072b2; outline-offset: 2px; }
.view3d-frame { position: relative; }
.view3d-note { position: absolute; inset: 40% 0 auto; text-align: center; }
@media print { .view3d { display: none; } }
"""
"""Of the classes in :func:`fragment`, for the page's style sheet."""


FINEST_STEP = 0.01
"""mm, resolution of what moves from step to step; coarser for a part of more than 300 mm."""


STEPS = (
    '<div class="view3d-steps" role="group" aria-label="steps; space plays and pauses" hidden>'
    '<button type="button">Play</button><input type="range" min="0" value="0" step="1" aria-label="step">'
    "<output></output></div>"
)
"""Play, pause, and the step that is shown."""


@dataclass(frozen=True)
class Ball:
    """The tip of a tool, drawn as a ball that runs along a path.

    Attributes
    ----------
    trace : number of its trace, a surface
    path : number of the path in :attr:`Steps.paths`
    shape : (ny, nx, 3) mm, the ball with the tip of the tool at the origin
    """

    trace: int
    path: int
    shape: Array


@dataclass(frozen=True)
class Steps:
    """What changes in a view from step to step, of which there are K.

    Attributes
    ----------
    labels : K texts
    surface : number of the trace whose heights change
    heights : (K + 1, ny, nx) mm, before the first step and after every one; known everywhere
    paths : number of a trace and its K arrays (P, 3) mm, without points where nothing is drawn
    balls : that run along paths
    """

    labels: Sequence[str]
    surface: int
    heights: Array
    paths: Sequence[tuple[int, Sequence[Array]]]
    balls: Sequence[Ball] = ()


@dataclass(frozen=True)
class View:
    """One choice of what a figure shows.

    Attributes
    ----------
    traces : numbers of the traces that are seen
    labels : place (3,) mm and text of what is pointed at, always in sight; left out where the place is not known
    steps : what changes from step to step, played or chosen by the reader; None: nothing does
    """

    traces: Sequence[int]
    labels: Sequence[tuple[Array, str]] = field(default=())
    steps: Steps | None = None


def new_figure() -> Any:
    """Empty figure of plotly with axes in mm.

    Raises
    ------
    IsfError : EXPORT_FORMAT_UNKNOWN when plotly is not installed
    """
    try:
        import plotly.graph_objects as go  # type: ignore[import-untyped]
    except ImportError as error:
        raise IsfError(
            ErrorCode.EXPORT_FORMAT_UNKNOWN,
            "views in HTML need the package plotly",
            advice="pip install plotly; of a plan, a name that ends in .png gives a picture",
        ) from error
    figure = go.Figure()
    figure.update_layout(
        scene={f"{axis}axis": {"title": {"text": f"{axis} in mm"}} for axis in "xyz"},
        legend={"x": 0.01, "y": 0.98},
        margin={"l": 0, "r": 0, "t": 8, "b": 8},
        template="none",
    )
    return figure


def fragment(figure: Any, views: Mapping[str, View], label: str) -> str:
    """HTML of ``figure``, to stand once in a page above :func:`scripts`.

    ``views``: by the words of each choice, the first one at the start; a single one gives no choice. ``label``: what
    the picture shows, for those who do not see it.
    """
    shown = set(next(iter(views.values())).traces)
    for number, trace in enumerate(figure.data):
        trace.visible = number in shown
    ratio = _ratio(np.array([_side(figure, axis) for axis in "xyz"]))
    figure.update_layout(scene={"aspectmode": "manual", "aspectratio": ratio})
    drawn = json.loads(figure.to_json())
    chosen = {
        name: {
            "traces": list(view.traces),
            "annotations": [_annotation(place, text) for place, text in view.labels if np.isfinite(place).all()],
            **({} if view.steps is None else {"steps": _steps(view.steps, figure)}),
        }
        for name, view in views.items()
    }
    content = {"data": drawn["data"], "layout": drawn["layout"], "views": chosen}
    choice = "".join(
        f'<label><input type="radio" name="view3d" value="{escape(name, quote=True)}"{" checked" * (not k)}> '
        f"{escape(name)}</label>"
        for k, name in enumerate(views)
    )
    head = f'<fieldset class="view3d-choice"><legend>Coloured by</legend>{choice}</fieldset>' if len(views) > 1 else ""
    if any(view.steps is not None for view in views.values()):
        head += STEPS
    buttons = "".join(
        f'<button type="button" data-key="{key}" aria-label="{words}" title="{words}">{sign}</button>'
        for key, words, sign in (("+", "nearer", "+"), ("-", "farther", "\N{MINUS SIGN}"), ("Home", "as at first", "⌂"))
    )
    return (
        f'<div class="view3d">{head}<div class="view3d-frame">'
        f'<div class="view3d-plot" tabindex="0" role="application" aria-label="{escape(label, quote=True)}; arrow keys '
        'turn, plus and minus zoom"></div><p class="view3d-note">Opening …</p>'
        f'<div class="view3d-zoom">{buttons}</div></div>'
        f'<script type="text/plain" data-view3d>{_packed(json.dumps(content, allow_nan=False))}</script></div>'
    )


def scripts() -> str:
    """What makes the fragments of a page come alive; once, at the end of the page."""
    viewer = resources.files("isf_core.view").joinpath("viewer.js").read_text(encoding="utf-8")
    return f'<script type="text/plain" id="view3d-library">{_library()}</script>\n<script>{viewer}</script>'


def page(figure: Any, title: str) -> str:
    """A whole page with nothing but ``figure`` (all traces) and its ``title``."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>:root {{ color-scheme: light dark; }} body {{ margin: 8px 12px; "
        'font: 16px/1.4 system-ui, "DejaVu Sans", sans-serif; } h1 { font-size: 1.05rem; margin: 0 0 4px; }'
        f"{STYLE}.view3d-plot {{ height: calc(100vh - 60px); }}</style></head>\n<body>\n<h1>{escape(title)}</h1>\n"
        f"{fragment(figure, {'all': View(range(len(figure.data)))}, title)}\n{scripts()}\n</body>\n</html>\n"
    )


def _ratio(sides: Array) -> dict[str, float]:
    """Sides of the box around a figure of ``sides`` (3,) mm, the largest one 1."""
    return dict(zip("xyz", np.maximum(sides / sides.max(), FLATTEST).tolist(), strict=True))


def _steps(steps: Steps, figure: Any) -> dict[str, Any]:
    """For the page: whole units of ``unit`` mm; heights as differences from step to step, which pack well."""
    sheet = figure.data[steps.surface]
    low = [float(np.min(sheet.x)), float(np.min(sheet.y)), float(steps.heights.min())]
    high = [float(np.max(sheet.x)), float(np.max(sheet.y)), float(steps.heights.max())]
    for ball in steps.balls:
        tips = np.vstack(steps.paths[ball.path][1])
        if len(tips):
            low = np.minimum(low, tips.min(axis=0) + ball.shape.min(axis=(0, 1))).tolist()
            high = np.maximum(high, tips.max(axis=0) + ball.shape.max(axis=(0, 1))).tolist()
    unit = max(FINEST_STEP, float(np.abs([low, high]).max()) / 16_000.0)  # differences fit too
    heights = np.rint(steps.heights / unit).astype(np.int64)
    return {
        "labels": list(steps.labels),
        "surface": steps.surface,
        "unit": unit,
        "shape": list(heights.shape[1:]),
        "heights": _whole(np.diff(heights, axis=0, prepend=np.zeros_like(heights[:1]))),
        "paths": [
            {"trace": trace, "points": [_whole(np.rint(one / unit)) for one in points]} for trace, points in steps.paths
        ],
        "balls": [
            {
                "trace": ball.trace,
                "path": ball.path,
                "shape": np.round(np.moveaxis(ball.shape, -1, 0), 3).tolist(),
            }
            for ball in steps.balls
        ],
        "ranges": [[a, b] for a, b in zip(low, high, strict=True)],
        "ratio": _ratio(np.maximum(np.array(high) - low, 1e-3)),
    }


def _whole(values: Array) -> str:
    """Base64 of ``values`` as int16, little-endian."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<i2").tobytes()).decode("ascii")


def _side(figure: Any, axis: str) -> float:
    """mm, extent of all traces along ``axis``; 1 um at least."""
    values = [np.asarray(trace[axis], dtype=float).ravel() for trace in figure.data if trace[axis] is not None]
    known = np.concatenate([one[np.isfinite(one)] for one in values])
    return max(float(np.ptp(known)), 1e-3) if len(known) else 1e-3


def _annotation(place: Array, text: str) -> dict[str, Any]:
    return {
        **{axis: round(float(value), 3) for axis, value in zip("xyz", place, strict=True)},
        "text": escape(text),
        "font": {"color": "#111111", "size": 14},
        "bgcolor": "rgba(255,255,255,0.9)",
        "bordercolor": "#111111",
        "borderpad": 3,
        "arrowcolor": "#111111",
        "arrowhead": 6,
        "ax": 0,
        "ay": -48,
    }


@cache
def _library() -> str:
    import plotly.offline  # type: ignore[import-untyped]

    return _packed(plotly.offline.get_plotlyjs())


def _packed(text: str) -> str:
    """Base64 of the text as gzip; the same bytes at any time."""
    return base64.b64encode(gzip.compress(text.encode("utf-8"), 9, mtime=0)).decode("ascii")
