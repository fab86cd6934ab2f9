"""Distance of one shape from another: a map from above and how it is distributed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from isf_core.types import Array
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from isf_analysis.figures import style
from isf_analysis.measures.plan_mask import PlanMask
from isf_analysis.measures.scan_cloud import filled

CELLS = 180
"""Of the map, along its longer side."""

MM = 1e3
EVERYWHERE = PlanMask()


def compared(
    points: Array, signed: Array, tolerances: Sequence[float], title: str, mask: PlanMask = EVERYWHERE
) -> Figure:
    """Map and histogram of ``signed`` (N,) m at ``points`` (N, 3) m; ``tolerances`` mm.

    ``mask`` that the points were chosen by: cells outside of it stay empty, and its shapes are drawn.
    """
    figure = style.new_figure(9.0, maps=False)
    above, below = figure.subplots(2, 1, height_ratios=[2.2, 1.0])
    limit = style.rounded_limit(float(np.quantile(np.abs(signed), 0.995)) * MM)
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    apart = float(np.median(cKDTree(points[:, :2]).query(points[:: max(1, len(points) // 2000), :2], k=2)[0][:, 1]))
    cell = max(float((high - low).max()) / CELLS, 1.05 * apart, 1e-9)  # points on a grid leave no cell without one
    size = np.maximum(np.ceil((high - low) / cell).astype(int), 1)
    column, row = (np.minimum((points[:, k] - low[k]) / cell, size[k] - 1).astype(int) for k in (0, 1))
    total, count = np.zeros(size[::-1]), np.zeros(size[::-1])
    np.add.at(total, (row, column), signed)
    np.add.at(count, (row, column), 1.0)
    mean = filled(np.where(count > 0, total / np.maximum(count, 1.0), np.nan))
    middles = np.meshgrid(*(low[k] + cell * (np.arange(size[k]) + 0.5) for k in (0, 1)))
    chosen = mask.counts(np.column_stack([part.ravel() for part in middles])).reshape(mean.shape)
    mean[~(chosen | (count > 0))] = np.nan
    above.set_facecolor("#e9edf0")
    extent = (MM * low[0], MM * (low[0] + cell * size[0]), MM * low[1], MM * (low[1] + cell * size[1]))
    image = above.imshow(
        MM * mean, origin="lower", extent=extent, cmap=style.DEVIATION_MAP, vmin=-limit, vmax=limit, zorder=1
    )
    above.autoscale(False)  # an outline may reach far beyond the points
    for shape in (*mask.inside, *mask.outside):
        above.plot(*(MM * shape.outline.T), color=style.INK, linewidth=1.2, linestyle=(0, (5, 2)), zorder=3)
    above.set_aspect("equal")
    above.grid(False)
    above.set_title(title)
    above.set_xlabel("x [mm]")
    above.set_ylabel("y [mm]")
    figure.colorbar(image, ax=above, label="distance [mm], red: above", extend="both", shrink=0.85)
    below.hist(MM * np.clip(signed, -limit / MM, limit / MM), bins=80, color=style.PART)
    for band in tolerances:
        if band <= limit:
            below.axvline(-band, color=style.SET_POINT, linewidth=1.0)
            below.axvline(band, color=style.SET_POINT, linewidth=1.0)
    below.set_yscale("log")
    below.set_xlim(-limit, limit)
    below.set_title("How often; lines: tolerances")
    below.set_xlabel("distance [mm]")
    below.set_ylabel("points")
    return figure
