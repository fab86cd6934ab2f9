"""What every map of form errors is drawn with: the field of errors and the edge of the opening."""

from __future__ import annotations

import numpy as np
from isf_core.geometry.height_map import HeightMap
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from isf_analysis.figures import style
from isf_analysis.measures.deviation import OPENING_DEPTH, flange_level

MM = 1e3


def draw_errors(axes: Axes, error: HeightMap, limit: float) -> AxesImage:
    """Draw ``error`` (m) in colours up to ``limit`` mm either way; unknown cells stay grey."""
    x, y = MM * error.x, MM * error.y
    half_x, half_y = 0.5 * (x[1] - x[0]), 0.5 * (y[1] - y[0])
    axes.set_facecolor("#e9edf0")
    return axes.imshow(
        MM * error.z,
        origin="lower",
        extent=(x[0] - half_x, x[-1] + half_x, y[0] - half_y, y[-1] + half_y),
        cmap=style.DEVIATION_MAP,
        vmin=-limit,
        vmax=limit,
        interpolation="nearest",
        zorder=1,
    )


def draw_opening(axes: Axes, target: HeightMap) -> None:
    """The edge of the opening, found between the cells so that it looks as smooth as the part."""
    off = np.abs(target.z - flange_level(target))
    axes.contour(
        MM * target.x,
        MM * target.y,
        np.ma.masked_invalid(MM * off),
        levels=[MM * OPENING_DEPTH],
        colors=style.INK,
        linewidths=1.5,
        linestyles="solid",
        zorder=3,
    )
