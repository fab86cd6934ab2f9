"""The one plotting style: colours that colour-blind readers can tell apart, type that is readable on a phone.

Lines use the palette of Okabe and Ito; deviation maps use a diverging map with white at zero and one symmetric scale
for all maps that are compared.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

INK = "#1f2933"
MUTED = "#66727f"
GRID = "#dde3e8"

TARGET = "#1f2933"
"""The shape that was wanted."""
UNCORRECTED = "#D55E00"
"""The reference part, formed without correction."""
PART = "#0072B2"
"""The part of this report."""
SET_POINT = "#009E73"
"""Set-points and their tolerance bands."""
PREDICTION = "#B4548A"
"""What a model expected."""
LIMIT = "#E69F00"
"""Limits that were reached."""

DEVIATION_MAP = "RdBu_r"
"""Red: too high (under-formed); blue: too deep (over-formed); white: on target."""

WIDTH = 7.2
"""in, width of every figure: 1224 pixels, with type that stays readable when a phone shows it 370 wide."""
DPI = 170

_RC: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 11.5,
    "axes.titlesize": 12.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 9.0,
    "axes.labelsize": 11.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#9aa5b1",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 11,
    "ytick.labelsize": 11,
    "legend.fontsize": 10.5,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.dpi": DPI,
}


@contextmanager
def applied() -> Iterator[None]:
    """The style, for everything drawn inside the block; nothing else in the process is changed."""
    with mpl.rc_context(_RC):
        yield


def new_figure(height: float, *, maps: bool = False) -> Figure:
    """Empty figure of the width of all and ``height`` in, without pyplot; ``maps``: for axes with equal scales."""
    layout = ConstrainedLayoutEngine(compress=maps, w_pad=0.09, h_pad=0.06)
    figure = Figure(figsize=(WIDTH, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": "isf_analysis"})
    return stream.getvalue()


def legend_above(axes: Axes, columns: int = 4) -> None:
    """Legend in rows above the axes, where it hides no data; none where nothing has a name."""
    if not axes.get_legend_handles_labels()[0]:
        return
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        borderaxespad=0.15,
        handlelength=1.6,
        columnspacing=1.4,
    )


def legend_below(figure: Figure, axes: Axes, columns: int) -> None:
    """Legend of what has a name in ``axes``, below all axes of the ``figure``, which leave it the room.

    matplotlib has places outside of axes from 3.7 on; Ubuntu 24.04 comes with 3.6.3.
    """
    handles, labels = axes.get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="lower center", ncols=columns, handletextpad=0.3)
    height = legend.get_window_extent().y1 / figure.bbox.height
    layout = figure.get_layout_engine()
    assert isinstance(layout, ConstrainedLayoutEngine)  # of new_figure
    layout.set(rect=(0.0, height, 1.0, 1.0 - height))


def rounded_limit(largest: float) -> float:
    """Smallest round number (1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten) not below ``largest``; 1 for nothing."""
    if not np.isfinite(largest) or largest <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(largest))
    for step in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0):
        if largest <= step * power * (1 + 1e-9):
            return float(step * power)
    return float(10.0 * power)
